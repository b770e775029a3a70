"""The contract of plugins: the checks of what plugins return, and errors that name the plugin that broke it."""
