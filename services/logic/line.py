"""One daisy chain's half-duplex line, as its master sees it: requests out, answers in.

The link, simulated or serial, takes requests in order and gives one reply to each, perhaps an
empty one, under the request's own sequence number. So an answer can never be taken for that of
another request, however late it comes.
"""

from __future__ import annotations

from runtime.messages import BusReply, BusRequest
from runtime.wire.packet import Decoder, Packet, StatusPacket, encode


class Exchange:
    """One request and what has come back of it."""

    __slots__ = ("_decoder", "arrived", "doubled", "sent_ns", "sequence", "statuses")

    def __init__(self, sequence: int, sent_ns: int) -> None:
        self.sequence = sequence
        self.sent_ns = sent_ns
        self.arrived = False  # a reply came, be it empty
        self.statuses: dict[int, StatusPacket] = {}  # by module id
        self.doubled: set[int] = set()  # ids that answered more than once
        self._decoder = Decoder()

    @property
    def garbled(self) -> bool:
        """Bytes came that belong to no intact answer."""
        return self._decoder.discarded > 0 or bool(self.doubled)

    def take(self, data: bytes) -> None:
        """Add bytes that came back."""
        self.arrived = True
        for packet in self._decoder.feed(data):
            if type(packet) is StatusPacket:
                if packet.id in self.statuses:
                    self.doubled.add(packet.id)
                self.statuses[packet.id] = packet

    def close(self) -> None:
        """Nothing more will come: what has begun is garbage."""
        self._decoder.reset()
        for module_id in self.doubled:
            self.statuses.pop(module_id, None)

    def only(self, *module_ids: int) -> StatusPacket | None:
        """The one intact answer, if it is one of these modules' and nothing else came."""
        if self.garbled or len(self.statuses) != 1:
            return None
        (status,) = self.statuses.values()
        return status if status.id in module_ids else None


class Line:
    """Numbers requests and finds the exchange that a reply belongs to."""

    def __init__(self, chain: str, patience_ns: int) -> None:
        self.chain = chain
        self._patience_ns = patience_ns  # robot time after which no reply is expected any more
        self._sequence = 0
        self._open: dict[int, Exchange] = {}

    def send(self, packet: Packet, now_ns: int) -> tuple[Exchange, BusRequest]:
        """Put one packet on the line."""
        return self.send_bytes(encode(packet), now_ns)

    def send_bytes(self, data: bytes, now_ns: int) -> tuple[Exchange, BusRequest]:
        """Like `send`, of packets that are encoded already; only the last may be answered."""
        # Counted from robot time, so that a restarted master never meets its predecessor's replies.
        self._sequence = max(self._sequence + 1, now_ns // 1000)
        exchange = Exchange(self._sequence, now_ns)
        self._open[exchange.sequence] = exchange
        return exchange, BusRequest(
            stamp_ns=now_ns, chain=self.chain, sequence=exchange.sequence, data=data
        )

    def receive(self, reply: BusReply) -> None:
        """Hand a reply to its exchange; one that nobody waits for is dropped."""
        exchange = self._open.get(reply.sequence)
        if exchange is not None:
            exchange.take(reply.data)

    def over(self, exchange: Exchange, now_ns: int) -> bool:
        """Whether to wait for it no longer: something came, or it has taken too long."""
        return exchange.arrived or now_ns - exchange.sent_ns >= self._patience_ns

    def close(self, exchange: Exchange) -> None:
        """Later bytes under its number are nobody's."""
        exchange.close()
        self._open.pop(exchange.sequence, None)
