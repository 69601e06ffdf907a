// node load.mjs PAGE.html [RUNS]: opens a page of `brdffit view` in Chromium and prints, as one line of JSON, its size in
// MB and for each run the seconds from the start of the navigation until the data are on the graphics processor and until
// the first complete frame of all panels, at a width of 900 pixels. SwiftShader draws, so a frame costs CPU time.
import {chromium} from 'playwright-core';
import {statSync} from 'fs';
import {pathToFileURL} from 'url';
const [page, runs] = process.argv.slice(2);
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM || '/usr/bin/chromium', headless: true,
  args: ['--no-sandbox', '--disable-dev-shm-usage', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
});
const loaded = [], framed = [], log = [];
for (let run = 0; run < +(runs || 3); run++) {
  const context = await browser.newContext({viewport: {width: 900, height: 600}}), tab = await context.newPage();
  tab.on('console', message => message.type() === 'error' && log.push(message.text()));
  tab.on('pageerror', error => log.push(error.message));
  await tab.goto(pathToFileURL(page).href, {waitUntil: 'commit'});
  await tab.waitForFunction(() => performance.getEntriesByName('first frame').length, null, {timeout: 120000});
  const [a, b] = await tab.evaluate(() => ['loaded', 'first frame'].map(name => performance.getEntriesByName(name)[0].startTime));
  loaded.push(+(a / 1000).toFixed(2));
  framed.push(+(b / 1000).toFixed(2));
  await context.close();
}
console.log(JSON.stringify({megabytes: +(statSync(page).size / 1e6).toFixed(1), loaded, framed, console: log}));
await browser.close();
