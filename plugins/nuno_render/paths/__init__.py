"""Pictures by following the paths of light, by Mitsuba 3."""
