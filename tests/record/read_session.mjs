// Reads a session with @mcap/core alone: messages a topic, and the last joint state and timing.
import {McapIndexedReader} from '@mcap/core'; import {loadDecompressHandlers} from '@mcap/support';
import {FileHandleReadable} from '@mcap/nodejs'; import {open} from 'fs/promises';
import * as rosmsg from '@foxglove/rosmsg'; import * as ser from '@foxglove/rosmsg2-serialization';
const fh=await open(process.argv[2],'r');
const reader=await McapIndexedReader.Initialize({readable:new FileHandleReadable(fh),decompressHandlers:await loadDecompressHandlers()});
const n={},last={},dec={};
for await (const m of reader.readMessages()){const ch=reader.channelsById.get(m.channelId);n[ch.topic]=(n[ch.topic]??0)+1;
 if(ch.messageEncoding==='cdr'){ if(!dec[ch.topic]){const s=reader.schemasById.get(ch.schemaId);const d=rosmsg.parse(new TextDecoder().decode(s.data),{ros2:true});dec[ch.topic]=new ser.MessageReader(d);} last[ch.topic]=dec[ch.topic].readMessage(m.data);} }
console.log(JSON.stringify(n)); console.log(JSON.stringify(last['/leader/measured_js'],(k,v)=>ArrayBuffer.isView(v)?[...v]:typeof v==='bigint'?Number(v):v)); console.log(JSON.stringify(last['/loop/timing']));
