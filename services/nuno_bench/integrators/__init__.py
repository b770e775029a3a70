"""The skirt paper's experiment, repeated: four methods, split and unsplit bones."""
