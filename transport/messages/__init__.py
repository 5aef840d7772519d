"""What travels: messages in Python, checked when made, and their CDR payloads and back; no Zenoh in it.

Everybody may import it; it imports of the transport its errors, names of keys and array types alone.
"""
