"""Effects that a diagnosis looks for only where they are asked for by name; one file each.

Each further candidate makes every diagnosis slower, and gives what is in no library one more
stand-in to be named by mistake. These belong to stages that are no plain flexure stages, so that
whoever has one knows to ask. A file that moves one folder up is a candidate of every diagnosis.
"""
