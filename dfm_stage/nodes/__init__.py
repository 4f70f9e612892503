"""The ROS 2 nodes: thin, one file each; what they compute lives in the pure packages."""
