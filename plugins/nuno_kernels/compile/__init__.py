"""How kernels are compiled and kept: what one is made of, and its machine code on disk. No kernel stands here."""
