"""The effect library: one module, one effect, one `EFFECT`."""
