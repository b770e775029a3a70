"""The contract between services and plugins: scenes, state, messages, plugin protocols, topics."""

SCHEMA_VERSION = 1
