"""The compiled simulator: pure functions of flat arrays. Use `Simulator` and `Plant` instead."""
