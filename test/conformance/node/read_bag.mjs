// Reads every message of an MCAP file with Foxglove's packages and prints, per topic,
// what a Python test can compare: node read_bag.mjs FILE.mcap
import { open } from "node:fs/promises";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { loadDecompressHandlers } from "@mcap/support";

const file = await open(process.argv[2], "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const data = new Uint8Array(Number(length));
    const { bytesRead } = await file.read(data, 0, Number(length), Number(offset));
    if (bytesRead !== Number(length)) throw new Error(`short read at ${offset}`);
    return data;
  },
};
const reader = await McapIndexedReader.Initialize({
  readable,
  decompressHandlers: await loadDecompressHandlers(),
});

const readers = new Map();
const topics = {};
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  const text = new TextDecoder().decode(schema.data);
  readers.set(channel.id, new MessageReader(parse(text, { ros2: true })));
  topics[channel.topic] = {
    type: schema.name,
    encoding: channel.messageEncoding,
    qos: channel.metadata.get("offered_qos_profiles"),
    count: 0,
    values: 0,
    sum: 0,
    first_sequence: null,
    last_sequence: null,
  };
}

// Sums of the same order on both sides are equal to the last bit.
const add = (topic, values) => {
  for (const value of values) topic.sum += value;
  topic.values += values.length;
};
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  const topic = topics[channel.topic];
  const decoded = readers.get(message.channelId).readMessage(message.data);
  topic.count += 1;
  topic.first_sequence ??= message.sequence;
  topic.last_sequence = message.sequence;
  if (decoded.displacement) add(topic, decoded.displacement);
  if (decoded.x !== undefined && decoded.x.length !== undefined) add(topic, decoded.x);
  if (decoded.commanded) add(topic, [decoded.commanded.x, decoded.index]);
  if (decoded.temperature !== undefined) add(topic, [decoded.temperature]);
  if (decoded.data !== undefined) topic.text = decoded.data;
}

const statistics = reader.statistics;
console.log(
  JSON.stringify({
    profile: reader.header.profile,
    messages: Number(statistics.messageCount),
    chunks: reader.chunkIndexes.length,
    metadata: reader.metadataIndexes.map((index) => index.name),
    attachments: reader.attachmentIndexes.length,
    topics,
  }),
);
await file.close();
