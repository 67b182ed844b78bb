"""Holds an MCAP file against its specification, record by record, as `mcap doctor` does, with the records of the `mcap` package.

    python3 tests/doctor.py FILE

Prints what was found as JSON: `faults`, and how many `messages` there are in whole chunks, by schema, as `mcap recover` keeps
them of a file that was cut off. Exits with 1 where there are faults.
"""

import json
import struct
import sys
import zlib
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Attachment, AttachmentIndex, Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, Message, MessageIndex, Schema,
    Statistics,
)

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
KINDS = {
    Opcode.HEADER: Header, Opcode.FOOTER: Footer, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.CHUNK: Chunk,
    Opcode.MESSAGE_INDEX: MessageIndex, Opcode.CHUNK_INDEX: ChunkIndex, Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex, Opcode.STATISTICS: Statistics, Opcode.DATA_END: DataEnd,
}


def records(data, begin):
    """Offset, opcode, end and record of each whole one; ends where one is cut off."""
    at = begin
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        end = at + HEAD.size + length
        if end > len(data):
            return
        content = data[at + HEAD.size:end]
        record = None
        if opcode == Opcode.MESSAGE:
            record = Message.read(ReadDataStream(BytesIO(content)), length)
        elif opcode in KINDS:
            record = KINDS[opcode].read(ReadDataStream(BytesIO(content)))
        yield at, opcode, end, record
        if opcode == Opcode.FOOTER:
            return
        at = end


class Doctor:
    def __init__(self, data):
        self.data = data
        self.faults = []
        self.schemas, self.channels = {}, {}
        self.counts = {}
        self.chunks, self.attachments = {}, {}
        self.indexes = {}

    def expect(self, is_right, fault):
        if not is_right:
            self.faults.append(fault)

    def walk(self):
        self.expect(self.data.startswith(MAGIC), "it does not begin as an MCAP file")
        last = None
        for at, opcode, end, record in records(self.data, len(MAGIC)):
            if at == len(MAGIC):
                self.expect(opcode == Opcode.HEADER, "the first record is no header")
            if opcode == Opcode.CHUNK:
                self.chunks[at] = (record, end, self.chunk(at, record))
                last = at
            elif opcode == Opcode.MESSAGE_INDEX:
                self.index(last, at, record)
            elif opcode == Opcode.ATTACHMENT:
                self.attachments[at] = (record, end)
                content = self.data[at + HEAD.size:end - 4]
                (checksum,) = struct.unpack("<I", self.data[end - 4:end])
                self.expect(checksum in (0, zlib.crc32(content)), f"the checksum of the attachment at {at}")
            elif opcode == Opcode.DATA_END:
                checksum = record.data_section_crc
                self.expect(checksum in (0, zlib.crc32(self.data[:at])), "the checksum of the data section")
                return self.summary(end)
        self.faults.append("it has no end")

    def chunk(self, at, chunk):
        self.expect(chunk.compression in ("", "lz4", "zstd"), f"the compression of the chunk at {at}")
        if chunk.compression:
            return {}
        self.expect(len(chunk.data) == chunk.uncompressed_size, f"the size of the chunk at {at}")
        self.expect(chunk.uncompressed_crc in (0, zlib.crc32(chunk.data)), f"the checksum of the chunk at {at}")
        messages, end = {}, 0
        for offset, opcode, end, record in records(chunk.data, 0):
            if opcode == Opcode.SCHEMA:
                self.expect(record.id != 0, f"a schema in the chunk at {at} has the number 0")
                known = self.schemas.setdefault(record.id, record)
                self.expect(known == record, f"schema {record.id} is told in two ways")
                if record.encoding == "jsonschema":
                    json.loads(record.data)
            elif opcode == Opcode.CHANNEL:
                self.expect(record.schema_id in self.schemas, f"channel {record.id} has an unknown schema")
                known = self.channels.setdefault(record.id, record)
                self.expect(known == record, f"channel {record.id} is told in two ways")
            elif opcode == Opcode.MESSAGE:
                channel = self.channels.get(record.channel_id)
                self.expect(channel is not None, f"a message in the chunk at {at} is of an unknown channel")
                self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
                messages.setdefault(record.channel_id, []).append((record.log_time, offset))
                if channel is not None and channel.message_encoding == "json":
                    json.loads(record.data)
            else:
                self.faults.append(f"record {opcode} in the chunk at {at}")
        self.expect(end == len(chunk.data), f"the last record of the chunk at {at} is cut off")
        times = [time for entries in messages.values() for time, _ in entries]
        told = (chunk.message_start_time, chunk.message_end_time)
        self.expect(told == (min(times, default=0), max(times, default=0)), f"the times of the chunk at {at}")
        return messages

    def index(self, chunk, at, index):
        if chunk is None:
            return self.faults.append(f"the message index at {at} stands before all chunks")
        self.indexes.setdefault(chunk, {})[index.channel_id] = at
        messages = self.chunks[chunk][2].get(index.channel_id, [])
        self.expect(sorted(index.records) == sorted(messages), f"the message index at {at}")

    def summary(self, begin):
        seen, footer, statistics = {Opcode.CHUNK_INDEX: [], Opcode.ATTACHMENT_INDEX: []}, None, None
        for at, opcode, end, record in records(self.data, begin):
            if opcode in seen:
                seen[opcode].append(record)
            elif opcode == Opcode.STATISTICS:
                statistics = record
            elif opcode == Opcode.FOOTER:
                footer = record
                self.expect(record.summary_start == begin, "the footer says where the summary begins")
                checksum = zlib.crc32(self.data[begin:end - 4])
                self.expect(record.summary_crc in (0, checksum), "the checksum of the summary")
                self.expect(self.data[end:] == MAGIC, "it does not end as an MCAP file")
        if footer is None or statistics is None:
            return self.faults.append("there is no footer, or no statistics")
        self.expect(len(seen[Opcode.CHUNK_INDEX]) == len(self.chunks), "one index for each chunk")
        for index in seen[Opcode.CHUNK_INDEX]:
            self.chunk_index(index)
        self.expect(len(seen[Opcode.ATTACHMENT_INDEX]) == len(self.attachments), "one index for each attachment")
        for index in seen[Opcode.ATTACHMENT_INDEX]:
            attachment, end = self.attachments.get(index.offset, (None, 0))
            is_right = attachment is not None and index.length == end - index.offset
            is_right = is_right and (index.name, index.data_size) == (attachment.name, len(attachment.data))
            self.expect(is_right, f"the index of the attachment at {index.offset}")
        told = (statistics.message_count, statistics.schema_count, statistics.channel_count, statistics.chunk_count,
                statistics.attachment_count, statistics.channel_message_counts)
        found = (sum(self.counts.values()), len(self.schemas), len(self.channels), len(self.chunks),
                 len(self.attachments), self.counts)
        self.expect(told == found, f"the statistics are {told}, and there are {found}")
        times = [time for chunk, _, _ in self.chunks.values() for time in (chunk.message_start_time, chunk.message_end_time)]
        told = (statistics.message_start_time, statistics.message_end_time)
        self.expect(told == (min(times, default=0), max(times, default=0)), "the times of the statistics")

    def chunk_index(self, index):
        chunk, end, _ = self.chunks.get(index.chunk_start_offset, (None, 0, {}))
        if chunk is None:
            return self.faults.append(f"there is no chunk at {index.chunk_start_offset}")
        at = index.chunk_start_offset
        told = (index.message_start_time, index.message_end_time, index.chunk_length, index.compression,
                index.compressed_size, index.uncompressed_size)
        found = (chunk.message_start_time, chunk.message_end_time, end - at, chunk.compression, len(chunk.data),
                 chunk.uncompressed_size)
        self.expect(told == found, f"the index of the chunk at {at} is {told}, and it has {found}")
        self.expect(index.message_index_offsets == self.indexes.get(at, {}), f"the message indexes of the chunk at {at}")
        length = 0
        for offset in index.message_index_offsets.values():
            length += HEAD.size + HEAD.unpack_from(self.data, offset)[1]
        self.expect(index.message_index_length == length, f"the length of the message indexes of the chunk at {at}")

    def by_schema(self):
        named = {}
        for channel, count in self.counts.items():
            name = self.schemas[self.channels[channel].schema_id].name
            named[name] = named.get(name, 0) + count
        return named


def main(path):
    with open(path, "rb") as file:
        doctor = Doctor(file.read())
        try:
            doctor.walk()
            if not doctor.faults:
                # The package's own way through the indexes, checksums and all.
                file.seek(0)
                read = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
                doctor.expect(read == sum(doctor.counts.values()), f"{read} messages are found by the index")
        except (McapError, ValueError, KeyError, struct.error) as error:
            doctor.faults.append(repr(error))
    print(json.dumps({"faults": doctor.faults, "messages": doctor.by_schema()}))
    return 1 if doctor.faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
