"""Methods that advance cloth in time: explicit, implicit and XPBD. The forces come from nuno_kernels and plugins."""
