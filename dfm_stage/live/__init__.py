"""The live view: what the loop does, as a page on this machine, and the operator's buttons."""
