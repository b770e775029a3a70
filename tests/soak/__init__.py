"""Reliability at length, by `make soak`: what must hold however long, whatever breaks and whoever asks.

Here belongs what takes hours and writes the tables of docs/measured/reliability.md. A small share of each part is run
by the tests in tests/services; a law that a minute can show is a test there.
"""
