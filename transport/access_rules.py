"""Who may do what: the access rules of the node's router, one set per role."""

from __future__ import annotations

from typing import Any

from transport.keys import perception_prefix, query_key, scan_key, stance_key, status_key

# Roles that get a certificate; the node is the router that enforces the rules.
ROLES = ("node", "gait", "planner", "viewer")


def access_control(robot: str) -> dict[str, Any]:
    """The `access_control` section of the router's Zenoh configuration.

    Nothing is allowed but: planner and viewer read everything under `<robot>/perception/v1` and ask for the
    newest grid; the planner also requests scans; gait publishes stance pauses. A rule without `flows` would
    hold in both directions, and `**` does not cover chunks that start with `@`: both are spelt out.
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
        rule("ask", "ingress", ["query"], [query_key(robot), status_key(robot)]),
        rule("trigger", "ingress", ["query"], [scan_key(robot)]),
        rule("stance_in", "ingress", serving, stance_keys),
        rule("stance_out", "egress", [*subscribing, "query"], stance_keys),
    ]
    reading = ["read", "history", "send", "ask"]
    policies = {"planner": [*reading, "trigger"], "viewer": reading, "gait": ["stance_in", "stance_out"]}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        # One property per subject: several would all have to hold at once.
        "subjects": [{"id": role, "cert_common_names": [role]} for role in policies],
        "policies": [{"rules": allowed, "subjects": [role]} for role, allowed in policies.items()],
    }
