// node cubes.mjs FILE...: what ktx-parse (.ktx2) and three.js's DDSLoader (.dds) make of cube maps, one JSON line a file.
import {read} from 'ktx-parse';
import {readFileSync} from 'fs';
import {DDSLoader} from 'three/addons/loaders/DDSLoader.js';
for (const file of process.argv.slice(2)) {
  const bytes = readFileSync(file);
  if (file.endsWith('.ktx2')) {
    const ktx = read(new Uint8Array(bytes));
    console.log(JSON.stringify({faces: ktx.faceCount, size: ktx.pixelWidth, format: ktx.vkFormat, levels: ktx.levels.length}));
  } else {
    const data = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
    const dds = new DDSLoader().parse(data, true);
    console.log(JSON.stringify({
      cube: dds.isCubemap, size: dds.width, format: dds.format, levels: dds.mipmapCount,
      images: dds.mipmaps.map(each => [each.width, each.data.length]),
    }));
  }
}
