"""Who gets in and what listens: a guarded run, and everybody who tries what is not theirs."""
