"""Counts messages a subscription never saw, from the numbers the publisher gives them (DDS sequence numbers)."""

import json
from dataclasses import dataclass


@dataclass(slots=True)
class TopicLoss:
    """What the sequence numbers of one topic tell.

    Numbers start at 1 and grow by one per message of one publisher. A fall to 1 is a publisher that was started
    again; any other number that does not grow means that several publishers take turns, whose gaps cannot be told
    from each other: then `lost` stays what it was and `countable` turns False.
    """

    lost: int = 0
    """Messages missing between two that came."""
    before_first: int = 0
    """Messages sent before the first that came."""
    countable: bool = True
    last_number: int = 0

    def note(self, number: int) -> None:
        """Take the number of the next message received."""
        step = number - self.last_number
        if step != 1 and self.countable:
            if self.last_number == 0:
                self.before_first = number - 1
            elif step > 1:
                self.lost += step - 1
            elif number != 1:
                self.countable = False
        self.last_number = number


class LossLedger:
    """The losses of every topic of a recording."""

    def __init__(self) -> None:
        self.topics: dict[str, TopicLoss] = {}

    def topic(self, name: str) -> TopicLoss:
        """The account of topic `name`, opened when there is none."""
        return self.topics.setdefault(name, TopicLoss())

    @property
    def lost(self) -> int:
        """Messages missing in all topics where that can be counted."""
        return sum(account.lost for account in self.topics.values() if account.countable)

    def as_text(self) -> str:
        """JSON, topic -> {lost, before_first}; `lost` is null where several publishers took turns.

        Topics that nothing was received from are left out.
        """
        rows = {
            name: {"lost": account.lost if account.countable else None, "before_first": account.before_first}
            for name, account in self.topics.items()
            if account.last_number
        }
        return json.dumps(rows)
