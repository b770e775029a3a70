"""Cloth that falls on a ball and on cloth, in other engines and in ours."""
