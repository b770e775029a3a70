"""`nuno bench peers`: the stiff sheet in other engines and in ours, each in a process of its own."""
