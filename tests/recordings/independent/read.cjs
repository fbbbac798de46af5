// Reads a recording with @mcap/core and protobufjs, and prints what is in it as JSON: node read.cjs FILE
"use strict";
const { createHash } = require("node:crypto");
const { open } = require("node:fs/promises");
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers, protobufFromBinaryDescriptor } = require("@mcap/support");

const readable = (file) => ({
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, Number(length), Number(offset));
    return buffer;
  },
});

/** Add up the numbers of a message, field by field, in the order of the messages; NaN does not count. */
function add(sums, message, prefix) {
  for (const field of message.$type.fieldsArray) {
    const value = message[field.name];
    const name = prefix + field.name;
    for (const item of field.repeated ? value : [value]) {
      if (item == null) continue;
      if (item.$type) add(sums, item, `${name}.`);
      else {
        const number = Number(item);
        if (!Number.isNaN(number)) sums[name] = (sums[name] ?? 0) + number;
      }
    }
  }
}

async function main(path) {
  const file = await open(path, "r");
  const reader = await McapIndexedReader.Initialize({
    readable: readable(file),
    decompressHandlers: await loadDecompressHandlers(),
  });
  const types = new Map();
  const topics = {};
  let newest = 0n;
  let inOrder = true;
  for await (const message of reader.readMessages()) {
    inOrder &&= message.logTime >= newest;
    newest = message.logTime;
    const channel = reader.channelsById.get(message.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    if (!types.has(channel.schemaId)) {
      types.set(channel.schemaId, protobufFromBinaryDescriptor(schema.data).lookupType(schema.name));
    }
    topics[channel.topic] ??= {
      schema: schema.name, encoding: channel.messageEncoding, metadata: Object.fromEntries(channel.metadata),
      count: 0, first: String(message.logTime), sums: {},
    };
    const topic = topics[channel.topic];
    topic.count += 1;
    topic.last = String(message.logTime);
    add(topic.sums, types.get(channel.schemaId).decode(message.data), "");
  }
  const attachments = {};
  for await (const a of reader.readAttachments()) {
    attachments[a.name] = createHash("sha256").update(a.data).digest("hex");
  }
  const metadata = {};
  for await (const m of reader.readMetadata()) metadata[m.name] = Object.fromEntries(m.metadata);
  const messages = String(reader.statistics.messageCount);
  console.log(JSON.stringify({ inOrder, messages, topics, attachments, metadata }));
  await file.close();
}

main(process.argv[2]);
