// Prints every message, attachment and metadata record of a recording as a line of JSON, in the order of the
// sequence numbers, as Foxglove's own readers give them.
//
//     node read_recording.mjs FILE
//
// Integers of 64 bits become decimal strings, bytes become arrays, and numbers that JSON lacks become strings.

import { open } from "node:fs/promises";
import process from "node:process";

import rosmsg from "@foxglove/rosmsg";
import serialization from "@foxglove/rosmsg2-serialization";
import zstd from "@foxglove/wasm-zstd";
import { McapIndexedReader } from "@mcap/core";

/** Random access to a file, as McapIndexedReader wants it. */
class ReadableFile {
  constructor(handle) {
    this.handle = handle;
  }

  async size() {
    return BigInt((await this.handle.stat()).size);
  }

  async read(offset, size) {
    const buffer = new Uint8Array(Number(size));
    const { bytesRead } = await this.handle.read(buffer, 0, buffer.length, Number(offset));
    if (bytesRead !== buffer.length) {
      throw new Error(`${bytesRead} of ${size} bytes at ${offset}`);
    }
    return buffer;
  }
}

function plain(_key, value) {
  if (typeof value === "bigint") {
    return value.toString();
  }
  if (typeof value === "number" && !Number.isFinite(value)) {
    return String(value);
  }
  if (Object.is(value, -0)) {
    return "-0";
  }
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
}

await zstd.isLoaded;
const handle = await open(process.argv[2]);
const reader = await McapIndexedReader.Initialize({
  readable: new ReadableFile(handle),
  decompressHandlers: { zstd: (data, size) => zstd.decompress(data, Number(size)) },
});

const decoders = new Map();
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  const definitions = rosmsg.parse(new TextDecoder().decode(schema.data), { ros2: true });
  decoders.set(channel.id, new serialization.MessageReader(definitions));
}

const lines = [];
for await (const message of reader.readMessages()) {
  const { topic } = reader.channelsById.get(message.channelId);
  const content = decoders.get(message.channelId).readMessage(message.data);
  const { sequence, logTime, publishTime } = message;
  lines.push({ topic, sequence, logTime, publishTime, content });
}
lines.sort((one, other) => one.sequence - other.sequence);
for await (const { name, mediaType, data } of reader.readAttachments()) {
  lines.push({ attachment: name, mediaType, data });
}
for await (const { name, metadata } of reader.readMetadata()) {
  lines.push({ metadata: name, entries: Object.fromEntries(metadata) });
}
await handle.close();
process.stdout.write(lines.map((line) => `${JSON.stringify(line, plain)}\n`).join(""));
