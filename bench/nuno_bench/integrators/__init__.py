"""`nuno bench integrators`: the skirt paper's experiment, four methods with split and unsplit bones."""
