"""`nuno soak`: the long tests of reliability, one module per part, with the same checks as their quick ones."""
