"""How the body changes, in words for whoever looks on: which muscle comes or goes, who is outside.

`ExecutiveState` names the muscle; whether it is taken in or left out is told by the event that
began it, and, to who has not heard that, by the schema that was in use then.
"""

from __future__ import annotations

from runtime import messages as m

OUTSIDE = "not in the schema"
TAKEN_IN = "being taken in"
LEFT_OUT = "being left out"

_BEGUN = {"grow_started": "grow", "refit_started": "refit", "shrink_started": "shrink"}


class Growing:
    """Takes in messages (of other kinds, too) and keeps what tells how the body changes."""

    def __init__(self) -> None:
        self._muscle = ""
        self._first = False  # there was no schema before
        self._base: m.SchemaVersion | None = None  # in use when the change was first seen
        self._schema: m.SchemaVersion | None = None
        self._begun: m.Event | None = None  # the newest of its kinds

    def take(self, message: m.Message) -> None:
        """Take in one message."""
        match message:
            case m.ExecutiveState():
                if message.growing != self._muscle:
                    self._muscle, self._base = message.growing, self._schema
                    self._first = not message.schema_version
            case m.SchemaVersion():
                self._schema = message
                self._base = self._base or message
            case m.Event() if message.kind in _BEGUN:
                if self._begun is None or message.stamp_ns >= self._begun.stamp_ns:
                    self._begun = message

    @property
    def words(self) -> str:
        """What becomes of which muscle; "" while the body stays as it is."""
        if not self._muscle:
            return ""
        if self._first:
            return "learning the first schema"
        if self.leaving:
            return f"going on without {self._muscle}"
        if self._kind == "refit":
            return f"taking back {self._muscle}"
        known = self._base is not None and self._muscle in self._base.muscles
        return "learning the body anew" if known else f"taking in {self._muscle}"

    @property
    def leaving(self) -> str:
        """The muscle that is being left out of the schema; "" if none is."""
        known = self._base is not None and self._muscle in self._base.muscles
        return self._muscle if self._kind == "shrink" or (known and not self._kind) else ""

    def standing(self, module: m.ModuleInfo) -> str:
        """What its own state does not say of a muscle that is up; "" if nothing."""
        if module.kind != "muscle" or module.state != "up" or self._schema is None:
            return ""
        if module.name == self.leaving:
            return LEFT_OUT
        if module.name in self._schema.muscles:
            return ""
        return TAKEN_IN if module.name == self._muscle else OUTSIDE

    @property
    def _kind(self) -> str:
        """Which of the three it is; "" when its beginning was not heard."""
        begun = self._begun
        about = begun is not None and begun.data.get("muscle") == self._muscle != ""
        return _BEGUN[begun.kind] if begun is not None and about else ""
