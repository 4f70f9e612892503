"""Effects that a diagnosis looks for where the common ones leave more than noise; one file each.

Each further candidate makes a diagnosis slower, and gives what is in no library one more stand-in
to be named by mistake. These belong to stages that are no plain flexure stages: they come last.
A file that moves one folder up is a candidate from the first.
"""
