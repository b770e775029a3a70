"""`nuno bench speed`: cases that are timed, beside what the machine could do at best."""
