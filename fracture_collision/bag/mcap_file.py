"""Reads one MCAP file from its beginning, without its index: a killed recorder wrote none.

https://mcap.dev/spec. Records are found by their lengths; the last one may be truncated. Chunks are read in the order
of their times and their messages merged, as by readers with an index. No allocation relies on a stated size alone: no
record is longer than the file, no chunk larger than it states, or than LARGEST_CHUNK and LARGEST_RATIO allow.
"""

from __future__ import annotations

import heapq
import os
import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema


class BagError(ValueError):
    """Not a bag, or one without a run or with an incomplete one."""


MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC, ZSTD_MAGIC = b"SQLite format 3\0", b"\x28\xb5\x2f\xfd"  # rosbag2's other storage, and its compression
CONVERT = "convert the bag: `pip install rosbags`, then `rosbags-convert --src BAG --dst NEW --dst-storage mcap`"
# [bytes] Decompressed. A writer ends a chunk above about one megabyte, so it has at most that and one message.
LARGEST_CHUNK = 1 << 29
# Meshes and contacts compress to a half or a tenth. A large chunk that states more than a thousand times its size is an
# attempt to exhaust memory.
LARGEST_RATIO = 1000
SMALL_CHUNK = 1 << 24  # [bytes] Decompressed; up to here the ratio is not checked.
# Records of a chunk per byte in the file: times differ from message to message, so each takes about a byte or more.
MOST_RECORDS = 2
# [bytes] Of all definitions of a file, and of one record of metadata; a message's definition is some kilobytes.
LARGEST_DEFINITION = 1 << 24

_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_TIMES = struct.Struct("<QQ")  # a chunk begins with the times of its first and last message
_MESSAGE_TIME = struct.Struct("<HIQ")
_MESSAGE = struct.Struct("<HIQQ")  # a message begins with its channel, sequence, time, and time of publication
_ID = struct.Struct("<H")  # a definition begins with its id
_MALFORMED = (McapError, struct.error, UnicodeDecodeError, OverflowError)


class Piece(NamedTuple):
    """A chunk, or a message that stands alone."""

    time: int  # [ns] of its first message
    begin: int  # of the record's content in the file
    size: int
    opcode: int


class FoundMessage(NamedTuple):
    """A message with the definitions of its channel and its type."""

    schema: Schema | None
    channel: Channel
    message: Message


class McapFile:
    """The contents of a file. Raises BagError if it is not an MCAP file, or damaged other than by truncation."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.pieces: list[Piece] = []
        self.metadata: list[Metadata] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._definition_bytes = 0  # of both
        self._are_chunks_searched = False  # for definitions
        self.is_whole = False  # ends with a footer and MAGIC
        self.lost_bytes = 0  # after the last whole record, if it does not
        with _open(path) as stream:
            self._scan(stream)

    def channels(self, on_damage: Callable[[BagError], None] | None = None) -> list[tuple[Channel, Schema | None]]:
        """All that are defined, by id. `on_damage` as for `messages`."""
        if not (self.is_whole and self._channels):  # the end of most files repeats what their chunks define
            self._define_from_chunks(on_damage)
        return [(channel, self._schemas.get(channel.schema_id)) for _, channel in sorted(self._channels.items())]

    def messages(
        self, topics: Collection[str] | None = None, on_damage: Callable[[BagError], None] | None = None
    ) -> Iterator[FoundMessage]:
        """All messages, or those of `topics`, in the order of their times, and in file order for equal times.

        A damaged chunk raises BagError; with `on_damage` it is skipped, and the error passed to that.
        """
        waiting: list[tuple[int, int, int, Piece | Message]] = [
            (piece.time, piece.begin, -1, piece) for piece in self.pieces
        ]
        heapq.heapify(waiting)
        with _open(self.path) as stream:
            while waiting:
                _, begin, _, item = heapq.heappop(waiting)
                if isinstance(item, Message):
                    yield self._found(item)
                    continue
                try:
                    inside = self._messages_of(stream, item)
                    for index, message in enumerate(inside):
                        channel = self._channel(message, item)
                        if topics is None or channel.topic in topics:
                            heapq.heappush(waiting, (message.log_time, begin, index, message))
                except BagError as error:
                    if on_damage is None:
                        raise
                    on_damage(error)

    # --- records ---------------------------------------------------------------------------------------------------

    def _scan(self, stream: IO[bytes]) -> None:
        size = os.fstat(stream.fileno()).st_size
        first = stream.read(len(SQLITE_MAGIC))
        if first == SQLITE_MAGIC:
            raise BagError(f"{self.path}: an SQLite file; {CONVERT}")
        if first.startswith(ZSTD_MAGIC):
            raise BagError(f"{self.path}: a compressed file; {CONVERT}")
        if not first.startswith(MAGIC):
            raise BagError(f"{self.path}: not an MCAP file")
        at = len(MAGIC)
        has_footer = False
        while at < size:
            stream.seek(at)
            head = stream.read(_HEAD.size)
            if has_footer:
                self.is_whole = head == MAGIC
                break
            if len(head) < _HEAD.size:
                break
            opcode, length = _HEAD.unpack(head)
            begin = at + _HEAD.size
            if opcode == 0 or length > size - begin:
                break
            self._note(stream, opcode, begin, length)
            has_footer = opcode == Opcode.FOOTER
            at = begin + length
        self.lost_bytes = 0 if self.is_whole else size - at

    def _note(self, stream: IO[bytes], opcode: int, begin: int, length: int) -> None:
        if opcode == Opcode.CHUNK and length >= _TIMES.size:
            time, _ = _TIMES.unpack(stream.read(_TIMES.size))
            self.pieces.append(Piece(time, begin, length, opcode))
        elif opcode == Opcode.MESSAGE and length >= _MESSAGE_TIME.size:
            *_, time = _MESSAGE_TIME.unpack(stream.read(_MESSAGE_TIME.size))
            self.pieces.append(Piece(time, begin, length, opcode))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            if length > LARGEST_DEFINITION:
                raise BagError(f"{self.path}: a definition of {length} bytes at byte {begin}")
            content = stream.read(length)
            try:
                if opcode == Opcode.METADATA:
                    self.metadata.append(Metadata.read(ReadDataStream(BytesIO(content))))
                else:
                    self._define(opcode, content, begin)
            except _MALFORMED as error:
                raise self._damaged(begin, error) from error

    def _define(self, opcode: int, content: bytes, begin: int) -> None:
        """Later definitions of an id repeat the first one, which is kept."""
        kind, known = (Schema, self._schemas) if opcode == Opcode.SCHEMA else (Channel, self._channels)
        if _ID.unpack_from(content)[0] in known:
            return
        self._definition_bytes += len(content)
        if self._definition_bytes > LARGEST_DEFINITION:
            raise BagError(f"{self.path}: more than {LARGEST_DEFINITION} bytes of definitions at byte {begin}")
        record = kind.read(ReadDataStream(BytesIO(content)))
        known[record.id] = record

    def _define_from_chunks(self, on_damage: Callable[[BagError], None] | None = None) -> None:
        if self._are_chunks_searched:
            return
        self._are_chunks_searched = True
        with _open(self.path) as stream:
            for piece in self.pieces:
                try:
                    self._messages_of(stream, piece)
                except BagError as error:
                    if on_damage is None:
                        raise
                    on_damage(error)

    def _messages_of(self, stream: IO[bytes], piece: Piece) -> list[Message]:
        """The messages of a piece; its definitions are stored."""
        stream.seek(piece.begin)
        content = stream.read(piece.size)
        try:
            if piece.opcode == Opcode.MESSAGE:
                return [_message(content)]
            data = self._opened(Chunk.read(ReadDataStream(BytesIO(content))), piece)
            return self._messages_in(data, piece)
        except _MALFORMED as error:
            raise self._damaged(piece.begin, error) from error

    def _messages_in(self, data: bytes, piece: Piece) -> list[Message]:
        """The messages of a chunk's decompressed data; its definitions are stored."""
        messages: list[Message] = []
        at, left = 0, MOST_RECORDS * piece.size
        while at < len(data):
            if not left:
                words = f"has more than {MOST_RECORDS * piece.size} records, which is too many for its size"
                raise BagError(f"{self.path}: the chunk at byte {piece.begin} {words}")
            opcode, length = _HEAD.unpack_from(data, at)
            at, left = at + _HEAD.size, left - 1
            if length > len(data) - at:
                raise self._damaged(piece.begin, "a record is longer than its chunk")
            if opcode == Opcode.MESSAGE:
                messages.append(_message(data[at : at + length]))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, data[at : at + length], piece.begin)
            at += length
        return messages

    def _opened(self, chunk: Chunk, piece: Piece) -> bytes:
        """The chunk, decompressed. The library's own function allocates the size that the compressed data state."""
        size = chunk.uncompressed_size
        if size > LARGEST_CHUNK or size > max(SMALL_CHUNK, LARGEST_RATIO * len(chunk.data)):
            raise BagError(f"{self.path}: the chunk at byte {piece.begin} states {size} bytes, which is too many")
        try:
            if chunk.compression == "zstd":
                source = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(BytesIO(chunk.data))
                data = _read_all(source.read, size)
            elif chunk.compression == "lz4":
                data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
            elif not chunk.compression:
                data = chunk.data
            else:
                raise BagError(f"{self.path}: the chunk at byte {piece.begin} is compressed as {chunk.compression!r}")
        except (zstandard.ZstdError, RuntimeError, EOFError) as error:
            raise self._damaged(piece.begin, error) from error
        if len(data) != size:
            found = "more" if len(data) > size else str(len(data))
            raise self._damaged(piece.begin, f"it states {size} bytes and has {found}")
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise self._damaged(piece.begin, "its checksum is wrong")
        return data

    def _channel(self, message: Message, piece: Piece) -> Channel:
        if message.channel_id not in self._channels:
            self._define_from_chunks()
        channel = self._channels.get(message.channel_id)
        if channel is None:
            raise self._damaged(piece.begin, f"a message is of channel {message.channel_id}, which is not defined")
        return channel

    def _found(self, message: Message) -> FoundMessage:
        channel = self._channels[message.channel_id]
        if message.data.startswith(ZSTD_MAGIC):
            raise BagError(f"{self.path}: {channel.topic}: compressed messages; {CONVERT}")
        return FoundMessage(self._schemas.get(channel.schema_id), channel, message)

    def _damaged(self, begin: int, reason: Exception | str) -> BagError:
        words = str(reason) or type(reason).__name__
        return BagError(f"{self.path}: damaged at byte {begin}: {words}")


def _open(path: Path) -> IO[bytes]:
    try:
        return path.open("rb")
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from error


def _message(content: bytes) -> Message:
    channel_id, sequence, time, publish_time = _MESSAGE.unpack_from(content)
    return Message(channel_id, time, content[_MESSAGE.size :], publish_time, sequence)


def _read_all(read: Callable[[int], bytes], size: int) -> bytes:
    """`size` bytes and one more if there is one, in steps: memory grows with the bytes, not the stated size."""
    parts, left = [], size + 1
    while left and (part := read(min(left, 1 << 20))):
        parts.append(part)
        left -= len(part)
    return b"".join(parts)
