"""Tools of sweeps: executors of points (here, in processes, on a cluster), and storage of results."""
