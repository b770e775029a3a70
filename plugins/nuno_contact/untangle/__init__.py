"""Untangling: cloth that passes through itself or other cloth at the start is moved until it does so no more."""
