"""`nuno bench peers`: one cloth in other engines and in ours, each in a process of its own."""
