// Numbers under the panels.

// The code of 255 that is displayed for a linear value; display.frag has it too.
function code(linear, exposure) {
  const c = (linear * exposure) / (1 + 0.25 * linear * exposure);
  return 255 * Math.min(c < 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055, 1);
}

// Of each panel against the reference, the last one: RMS of what is displayed (in codes of 255), and energy.
function figures() {
  const {width: full, height, frame} = state.shown, count = panels.length, width = full / count;
  const all = new Float32Array(full * height * 4), exposure = 2 ** value("exposure");
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.readPixels(0, 0, full, height, gl.RGBA, gl.FLOAT, all);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  const at = (panel, x, y) => 4 * (y * full + panel * width + x);
  const rms = [], sums = [];
  for (let panel = 0; panel < count; panel++) {
    let squares = 0, sum = 0;
    for (let y = 0; y < height; y++)
      for (let x = 0; x < width; x++)
        for (let c = 0; c < 3; c++) {
          const linear = all[at(panel, x, y) + c];
          sum += linear;
          squares += (code(linear, exposure) - code(all[at(count - 1, x, y) + c], exposure)) ** 2;
        }
    rms.push(Math.sqrt(squares / (width * height * 3)));
    sums.push(sum);
  }
  return {rms, energy: sums.map(sum => sum / sums[count - 1]), width: full, height};
}

function tellFigures() {
  const {rms, energy} = figures();
  panels.forEach((panel, k) => {
    $("names").children[k].querySelector("span").textContent = panel.reference
      ? `${state.frame} frames of ${state.samples} samples`
      : `${rms[k].toFixed(1)} codes RMS off, energy ${(100 * energy[k]).toFixed(1)}%`;
  });
}
