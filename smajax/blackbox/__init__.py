"""Black boxes: input-output laws that know nothing of the wire."""
