"""The message bus: sessions, numbered messages and their encodings, queries, liveliness and health of services."""
