"""Messages as dataclasses or ROS 2 message objects, and their CDR payloads; independent of Zenoh.

Of the rest of the package, imports only exceptions, keys and array types; used by all other folders.
"""
