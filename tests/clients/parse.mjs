// node parse.mjs FILE.ktx2...: every file is parsed by ktx-parse and written back; the bytes must be the same.
import {read, write} from 'ktx-parse';
import {readFileSync} from 'fs';
let bad = 0;
for (const file of process.argv.slice(2)) {
  const bytes = new Uint8Array(readFileSync(file));
  const again = write(read(bytes), {keepWriter: true});
  if (Buffer.compare(Buffer.from(again), Buffer.from(bytes)) !== 0) { bad++; console.log(file, 'is written back otherwise'); }
}
process.exit(bad ? 1 : 0);
