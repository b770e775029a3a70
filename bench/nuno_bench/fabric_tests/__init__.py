"""Virtual instruments: what a textile laboratory measures of a fabric, on specimens in shipped scenes."""
