"""What lies between the nodes and the wire: Fast DDS and its shared memory, scheduling, codecs.

It knows no node; importing it changes nothing.
"""
