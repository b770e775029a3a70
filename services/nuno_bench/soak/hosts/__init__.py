"""Many hosts on one machine: the same bits however long the way, and what a cut of the network does."""
