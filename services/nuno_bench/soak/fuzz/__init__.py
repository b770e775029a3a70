"""`nuno soak fuzz`: whatever is read is accepted whole or refused in words, soon and in little memory."""
