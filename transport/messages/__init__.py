"""Messages in Python, checked on construction, and their CDR payloads; independent of Zenoh.

Any module may import it; of the transport it imports only errors, names of keys and array types.
"""
