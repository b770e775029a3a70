"""The stiff sheet in other engines and in ours, each in a process of its own: error beside time."""
