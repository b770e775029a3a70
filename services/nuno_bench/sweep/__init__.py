"""What sweeps share: where points are computed (here, in processes, on a cluster), and how they are kept."""
