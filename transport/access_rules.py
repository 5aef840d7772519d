"""Who may do what: the access rules of the node's router, one set per role."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from transport.keys import (
    claim_key,
    grid_keys,
    perception_prefix,
    query_key,
    scan_key,
    stance_key,
    status_key,
)

# Roles that get a certificate; the node is the router that enforces the rules.
ROLES = ("node", "gait", "planner", "viewer")


def access_control(robot: str, members: Mapping[str, Sequence[str]] | None = None) -> dict[str, Any]:
    """The `access_control` section of the router's Zenoh configuration.

    Nothing is allowed but: planner and viewer read everything under `<robot>/perception/v1` and ask for the
    newest grid and the status; the planner also requests scans; gait publishes stance pauses; a second node may
    show that it waits for the name. A rule without `flows` would hold in both directions, and `**` does not cover
    chunks that start with `@`: both are spelt out.

    Args:
        robot: instance name.
        members: common names that have each role; None = the role's own name.
    """
    prefix, stance = perception_prefix(robot), stance_key(robot)
    perception = [f"{prefix}/**", f"{prefix}/**/@adv/**", f"{prefix}/@alive/**"]
    stance_keys = [stance, f"{stance}/@adv/**"]
    subscribing = ["declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
    serving = ["put", "reply", "declare_queryable", "liveliness_token"]

    def rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
        return {
            "id": name,
            "permission": "allow",
            "flows": [flow],
            "messages": messages,
            "key_exprs": keys,
        }

    rules = [
        rule("read", "ingress", subscribing, perception),
        rule("history", "ingress", ["query"], [f"{prefix}/**/@adv/**"]),
        rule("send", "egress", serving, perception),
        rule("ask", "ingress", ["query"], [query_key(robot), status_key(robot), *grid_keys(robot)]),
        rule("trigger", "ingress", ["query"], [scan_key(robot)]),
        rule("stance_in", "ingress", serving, stance_keys),
        rule("stance_out", "egress", [*subscribing, "query"], stance_keys),
        rule("claim", "ingress", ["liveliness_token"], [claim_key(robot)]),
    ]
    reading = ["read", "history", "send", "ask"]
    policies = {
        "planner": [*reading, "trigger"],
        "viewer": reading,
        "gait": ["stance_in", "stance_out"],
        "node": ["claim"],
    }
    # A subject without names would stand for everybody.
    named = {role: list((members or {}).get(role, [] if members else [role])) for role in policies}
    named = {role: names for role, names in named.items() if names}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        # One property per subject: several would all have to hold at once.
        "subjects": [{"id": role, "cert_common_names": names} for role, names in named.items()],
        "policies": [{"rules": policies[role], "subjects": [role]} for role in named],
    }
