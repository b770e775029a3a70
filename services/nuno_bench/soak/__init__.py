"""`nuno soak`: the long tests of reliability, one folder per part, with the same checks as their quick ones."""
