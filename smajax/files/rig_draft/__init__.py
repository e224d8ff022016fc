"""The rig of a recording that was imported: a whole rig.toml, made from the template of its kind.

- ``kind``: the kind of the rig and the control that the recorded channels suggest.
- ``observation``: channels that are fitted, and parameters that such a fit can determine.
- ``start_values``: start values of heat loss and supply from a recorded temperature.
- ``draft``: the text of the rig, and the values in it that no recording gives.
"""

from smajax.files.rig_draft.draft import Assumption, RigDraft, draft_rig
from smajax.files.rig_draft.kind import NO_RIG, RigKind, suggest_kind, template_kinds

__all__ = ["NO_RIG", "Assumption", "RigDraft", "RigKind", "draft_rig", "suggest_kind", "template_kinds"]
