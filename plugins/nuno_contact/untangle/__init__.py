"""Untangling: cloth that passes through itself or other cloth where it starts is moved until it does so no more."""
