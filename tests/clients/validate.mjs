// node validate.mjs FILE.glb...: prints what the Khronos glTF validator finds, one JSON line a file.
import validator from 'gltf-validator';
import {readFileSync} from 'fs';
for (const file of process.argv.slice(2)) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), {maxIssues: 50});
  console.log(JSON.stringify({errors: report.issues.numErrors, messages: report.issues.messages.map(m => [m.code, m.message, m.pointer])}));
}
