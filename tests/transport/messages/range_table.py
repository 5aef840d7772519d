"""Table of ranges of docs/reference/message-ranges.md, made of the ranges that the code checks."""

from transport.messages.typestore import TYPES, inner_type, ranges, typestore


def checked_types() -> list[str]:
    """`TYPES`, each followed by the types of its submessages that have not come before."""
    found: dict[str, None] = {}

    def add(type_name: str) -> None:
        if type_name and type_name not in found:
            found[type_name] = None
            for _, (kind, details) in typestore().get_msgdef(type_name).fields:
                add(inner_type(kind, details))

    for type_name in TYPES:
        add(type_name)
    return list(found)


def range_rows() -> list[str]:
    """Rows of the table, one for each type."""
    rows = []
    for type_name in checked_types():
        parts: dict[str, list[str]] = {}
        for field, allowed in ranges(type_name).items():
            if str(allowed):
                parts.setdefault(str(allowed), []).append(f"`{field}`")
        text = "; ".join(f"{', '.join(names)}: {allowed}" for allowed, names in parts.items())
        if text:
            rows.append(f"| `{type_name.replace('guara_msgs/msg/', '')}` | {text} |")
    return rows
