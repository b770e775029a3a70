"""How services talk: sessions, numbered messages and their encodings, frames in lockstep, how each service does."""
