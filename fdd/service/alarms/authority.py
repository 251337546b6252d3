"""Who may do what to an alarm, and what a command may hold; after ISA-18.2, which asks for a reason for shelving.

=============  ===========================================================================
role           may
=============  ===========================================================================
read           list alarms
acknowledge    and acknowledge, shelve and unshelve
clear          and clear
approve        and put event time back, and say which baseline is in force
=============  ===========================================================================

Identity comes from the transport: over Zenoh from the key that a person may use, on the command line from the account
of the operating system. What a command says of its sender is checked against that, never believed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from fdd.config import Site
from fdd.limits import COMMENT_CHARACTERS, LimitError, name_within, text_within
from fdd.records import NANOSECONDS
from fdd.service.alarms.book import ACTIONS, AlarmError, Command

Role = Literal["read", "acknowledge", "clear", "approve"]
ROLES: tuple[Role, ...] = get_args(Role)
NEEDED: Mapping[str, Role] = {
    "acknowledge": "acknowledge",
    "shelve": "acknowledge",
    "unshelve": "acknowledge",
    "clear": "clear",
    "approve": "approve",
    "turn back": "approve",
}
LOCAL = "cli"
LONGEST_SHELVING_SECONDS = 90 * 86400.0


class CommandError(AlarmError):
    """A command that nobody may give: it says too much, too little, or what its sender may not."""


@dataclass(frozen=True)
class Authority:
    """The people of a site with their roles, and how long an alarm may be shelved.

    ``people`` is None where the site file names nobody: then nobody may command over the network. Whoever may write the
    store (the command line does) is trusted in any case: they hold the data.
    """

    people: Mapping[str, Role] | None = None
    longest_shelving: float = LONGEST_SHELVING_SECONDS

    @classmethod
    def of(cls, site: Site) -> Authority:
        """What the site file says of its operators."""
        options = site.operator
        people = getattr(options, "people", None)
        roles = None if people is None else {name: person.role for name, person in people.items()}
        return cls(roles, getattr(options, "longest_shelving", LONGEST_SHELVING_SECONDS))

    def permit(self, person: str, action: str) -> None:
        """Refuse what a person may not do over the network.

        Raises
        ------
        CommandError : not known, or not in a role that may.
        """
        if self.people is None:
            raise CommandError("the site file names nobody who may give commands; declare operator.people")
        role = self.people.get(person)
        if role is None:
            raise CommandError(f"{person!r} is none of operator.people ({', '.join(self.people) or 'nobody'})")
        if ROLES.index(role) < ROLES.index(NEEDED[action]):
            raise CommandError(f"{person!r} has role {role}; to {action} an alarm takes role {NEEDED[action]}")

    def check(self, command: Command) -> Command:
        """The command, if it can be journaled and carried out.

        Raises
        ------
        CommandError : a text, number or time that no command has; no reason; longer than may be shelved.
        """
        try:
            name_within(command.alarm, "the alarm's key")
            name_within(command.actor, "the name of who asks")
            name_within(command.through, "the way it came")
            text_within(command.comment, COMMENT_CHARACTERS, "the comment")
        except LimitError as error:
            raise CommandError(str(error)) from None
        if command.action not in ACTIONS:
            raise CommandError(f"there is no action {command.action!r:.60}; there are {', '.join(ACTIONS)}")
        if not command.alarm or not command.actor.strip():
            raise CommandError("a command names an alarm and who asks")
        if type(command.time) is not int or not 0 <= command.time < 2**62:
            raise CommandError("the time of the command is no time")
        if command.action == "shelve":
            self._check_shelving(command)
        return command

    def _check_shelving(self, command: Command) -> None:
        if not command.comment.strip():
            raise CommandError("shelving needs a reason; say it as the comment (ISA-18.2, 11.7)")
        days = self.longest_shelving / 86400.0
        if command.span is not None:
            if type(command.span) not in (int, float) or not 0.0 < command.span < math.inf:
                raise CommandError("the time to shelve for is no time")
            if command.span > self.longest_shelving:
                raise CommandError(f"an alarm is shelved for {days:g} days at most, not {command.span / 86400.0:.4g}")
        if command.until is not None:
            if type(command.until) is not int or not 0 < command.until < 2**62:
                raise CommandError("the time to shelve until is no time")
            if (command.until - command.time) / NANOSECONDS > self.longest_shelving:
                raise CommandError(f"an alarm is shelved for {days:g} days at most")
