// node browser.mjs FOLDER PAGE.html QUERY [SHOT.png]: serves this folder as /clients and FOLDER as /samples, opens the
// page in Chromium, waits until its title is "done" or "error", and prints its element `result` as one line of JSON.
import {chromium} from 'playwright-core';
import {createServer} from 'http';
import {readFileSync} from 'fs';
import {dirname, extname, join, normalize} from 'path';
import {fileURLToPath} from 'url';
const [folder, page, query, shot] = process.argv.slice(2);
const here = dirname(fileURLToPath(import.meta.url));
const types = {'.html': 'text/html', '.js': 'text/javascript', '.mjs': 'text/javascript', '.wasm': 'application/wasm'};
const server = createServer((request, response) => {
  const path = normalize(decodeURIComponent(request.url.split('?')[0]));
  if (path === '/favicon.ico') { response.writeHead(204).end(); return; }
  const root = path.startsWith('/samples/') ? join(folder, path.slice(9)) : join(here, path.slice(9));
  try {
    const data = readFileSync(root);
    response.writeHead(200, {'Content-Type': types[extname(root)] || 'application/octet-stream'}).end(data);
  } catch { response.writeHead(404).end(); }
}).listen(0, '127.0.0.1');
await new Promise(resolve => server.once('listening', resolve));
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM || '/usr/bin/chromium', headless: true,
  args: ['--no-sandbox', '--disable-dev-shm-usage', '--hide-scrollbars', '--use-angle=swiftshader',
    '--enable-unsafe-swiftshader', '--disable-background-networking'],
});
const tab = await browser.newPage({viewport: {width: 1200, height: 600}});
const log = [];
tab.on('console', message => message.type() === 'error' && log.push(message.text()));
tab.on('pageerror', error => log.push(error.message));
const url = page.startsWith('/samples/') ? page : '/clients/' + page;
await tab.goto(`http://127.0.0.1:${server.address().port}${url}?${query}`);
let text = '{}';
try {
  await tab.waitForFunction(() => /^(done|error)$/.test(document.title), null, {timeout: 240000});
  text = await tab.evaluate(() => document.getElementById('result').textContent);
} catch (error) { log.push('timeout'); }
if (shot) await tab.screenshot({path: shot});
console.log(JSON.stringify({...JSON.parse(text), console: log}));
await browser.close();
server.close();
