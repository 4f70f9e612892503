"""The ROS 2 nodes: thin, one file each; what they compute lives in the pure packages.

Whatever of it is imported, the nodes of the process are visible on this machine only, unless the
user said otherwise.
"""

from dfm_stage.middleware.discovery import keep_to_this_machine

keep_to_this_machine()
