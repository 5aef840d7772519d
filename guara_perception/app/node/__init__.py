"""The node: from a stance pause to published terrain."""
