// node viewer.mjs PAGE.html [SHOT.png]: opens a page of `brdffit view` in Chromium and uses mouse, wheel, keys and two
// fingers; prints what changed as one line of JSON: the camera, distance, level, what is shown, figures, errors.
import {chromium} from 'playwright-core';
import {pathToFileURL} from 'url';
const [page, shot] = process.argv.slice(2);
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM || '/usr/bin/chromium', headless: true,
  args: ['--no-sandbox', '--disable-dev-shm-usage', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
});
const context = await browser.newContext({viewport: {width: 600, height: 400}, hasTouch: true});
const tab = await context.newPage(), log = [];
tab.on('console', message => message.type() === 'error' && log.push(message.text()));
tab.on('pageerror', error => log.push(error.message));
await tab.goto(pathToFileURL(page).href + '?width=240');
// Its own frames would keep one core busy: they are drawn when asked for.
await tab.waitForFunction(() => panels.length > 1 && document.getElementById('view').onkeydown, null, {timeout: 120000});
const look = () => tab.evaluate(() => ({
  yaw: state.yaw, pitch: state.pitch, distance: value('distance'), level: value('level'), show: value('show'),
  move: $('move').checked, pointers: state.pointers.size,
}));
const found = {start: await look()};
const box = await tab.locator('#view').boundingBox(), x = box.x + box.width / 2, y = box.y + box.height / 2;
await tab.mouse.move(x, y);
await tab.mouse.down();
await tab.mouse.move(x + 40, y + 10);
await tab.mouse.up();
found.drag = await look();
await tab.mouse.wheel(0, 200);
await tab.waitForFunction(before => value('distance') !== before, found.drag.distance, {timeout: 60000});
found.wheel = await look();
await tab.locator('#view').focus();
for (const [name, key] of [['left', 'ArrowLeft'], ['nearer', '+'], ['level', ']'], ['difference', 'd'], ['wipe', 'w'], ['moving', ' ']]) {
  await tab.keyboard.press(key);
  found[name] = await look();
}
await tab.keyboard.press(' ');
await tab.keyboard.press('w');
const touch = await context.newCDPSession(tab);
const fingers = (type, ...points) => touch.send('Input.dispatchTouchEvent', {
  type, touchPoints: points.map(([dx, dy], id) => ({x: x + dx, y: y + dy, id})),
});
found.before = await look();
await fingers('touchStart', [0, 0]);
await fingers('touchMove', [30, 0]);
await fingers('touchEnd');
found.finger = await look();
await fingers('touchStart', [-20, 0], [20, 0]);
await fingers('touchMove', [-60, 0], [60, 0]);
await fingers('touchEnd');
found.pinch = await look();
await tab.waitForFunction(() => /RMS/.test($('names').textContent), null, {timeout: 200000});
found.figures = await tab.evaluate(() => $('names').textContent);
if (shot) await tab.screenshot({path: shot});
console.log(JSON.stringify({...found, console: log}));
await browser.close();
