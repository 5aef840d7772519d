"""Messages as dataclasses, checked on construction, and their CDR payloads; independent of Zenoh.

Imports only errors, keys and array types of the transport; used by all other folders.
"""
