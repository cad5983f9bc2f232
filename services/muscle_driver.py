"""Process: the master of one daisy chain, simulated or on a serial port."""

from __future__ import annotations

from collections.abc import Iterator

from runtime.logic import Logic
from runtime.messages import BusRequest, ChainCommand, Message, Reply
from runtime.process import Launch
from runtime.wire.link import SerialLink, parse_link
from services.logic.muscle_driver import MuscleDriver


def main(launch: Launch) -> None:
    """Run `driver-<chain>` of one robot."""
    chain = next(row for row in launch.settings.chain if row.name == launch.instance)
    driver = MuscleDriver(launch.settings, chain.name, launch.store)
    port = parse_link(chain.link, chain.baud)
    logic = driver if port is None else OverSerial(driver, SerialLink(port))
    launch.run(logic, unhurried=(ChainCommand,))  # a command counts from the next cycle on


class OverSerial:
    """A driver whose requests go to a serial port instead of the bus."""

    def __init__(self, driver: Logic, link: SerialLink) -> None:
        self.inputs, self.requests = driver.inputs, driver.requests
        self.period_ns = driver.period_ns
        self._driver = driver
        self._link = link

    def receive(self, message: Message, now_ns: int) -> None:
        """As the driver does."""
        self._driver.receive(message, now_ns)

    def answer(self, request: Message, now_ns: int) -> Reply:
        """As the driver does."""
        return self._driver.answer(request, now_ns)

    def tick(self, now_ns: int) -> Iterator[Message]:
        """As the driver does, until it has nothing more to say on the line."""
        talking = True
        while talking:
            talking = False
            for message in self._driver.tick(now_ns):
                if isinstance(message, BusRequest):
                    self._driver.receive(self._link.exchange(message), now_ns)
                    talking = True
                else:
                    yield message
