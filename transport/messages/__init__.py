"""What travels: messages in Python, checked when made, and their CDR payloads and back; no Zenoh in it.

Any module may import it; of the transport it imports only errors, names of keys and array types.
"""
