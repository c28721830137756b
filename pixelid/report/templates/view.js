// Sliders, three plots that move, and a line of numbers, around pixel.js.
"use strict";

const CYCLES = 11, SHOWN = 3, CYCLE_MS = 2500;  // simulated; in the window; for one to pass
const presets = JSON.parse(document.getElementById("presets").textContent);
const element = id => document.getElementById(id), preset = () => presets[+element("preset").value];
let state, result, light, playing, seed = 1, at = 1, last = 0;

const short = x => x === 0 || (x >= 9.5 && x < 1e5) ? x.toFixed(0) : x < 1e-3 ? x.toExponential(1) : x.toPrecision(2);
const prefixed = (x, unit) => {
  const [size, prefix] = [[1, ""], [1e-3, "m"], [1e-6, "µ"]].find(([size]) => x >= 0.9995 * size) || [1e-9, "n"];
  return x ? `${+(x / size).toPrecision(3)} ${prefix}${unit}` : `0 ${unit}`;
};
const hertz = x => x >= 999.5 ? `${+(x / 1000).toPrecision(3)} kHz` : `${+x.toPrecision(3)} Hz`;
// [field, label, lowest (none: zero, and a linear scale), highest, how it is written, whether the left end is zero]
const CONTROLS = [
  ["level", "Light level", p => p.level / 300, p => p.level * 300, x => `${short(x)} ${state.unit}`],
  ["contrast", "Contrast (± of the level)", null, () => 0.95, x => `${(100 * x).toFixed(0)} %`],
  ["frequency", "Frequency", () => 0.1, () => 5000, hertz],
  ["bandwidth", "Photoreceptor bandwidth", () => 0.1, () => 10, x => `× ${short(x)}`],
  ["on", "ON threshold", () => 0.03, () => 1, x => x.toPrecision(2)],
  ["off", "OFF threshold", () => 0.03, () => 1, x => x.toPrecision(2)],
  ["noise", "Threshold noise", null, () => 0.3, x => `${(100 * x).toPrecision(2)} %`],
  ["dead", "Dead time", () => 1e-6, () => 0.1, x => prefixed(x, "s"), true],
  ["leak", "Leak", () => 0.01, () => 100, x => `${+x.toPrecision(3)} events/s`, true],
  ["dark", "Dark current", p => p.level / 1000, p => p.level * 100, x => `${short(x)} ${state.unit}`, true],
].map(([field, label, low, high, written, zero]) => ({ field, label, low, high, written, zero }));

// Where the slider of a value stands, 0 to 1000, and the other way round; what a model has lies within its limits.
function scale({ field, low, high, zero }) {
  const own = preset()[field] || 0, top = Math.max(high(preset()), 1.5 * own);
  if (!low) return { position: value => 1000 * value / top, value: at => top * at / 1000 };
  const bottom = Math.min(low(preset()), own || Infinity), span = Math.log(top / bottom);
  return { position: value => value ? Math.max(1, 1000 * Math.log(value / bottom) / span) : 0,
    value: at => zero && at === 0 ? 0 : bottom * Math.exp(span * at / 1000) };
}

function choose() {
  const { cutoff } = response({ ...preset(), bandwidth: 1 }, preset().level);
  state = { ...preset(), bandwidth: 1, contrast: 0.6, frequency: +Math.min(50, cutoff / 4).toPrecision(2) };
  for (const control of CONTROLS) element(control.field).value = scale(control).position(state[control.field]);
  element("bandwidth").disabled = state.photoreceptor === "unlimited";
  element("left-out").textContent = state.left_out.length ? `Not simulated here: ${state.left_out.join(", ")}.` : "";
  compute();
}

function compute() {
  for (const { field, written } of CONTROLS) element(field).nextElementSibling.textContent = written(state[field]);
  const kind = document.querySelector("input[name=kind]:checked").value, cycle = 1 / state.frequency;
  light = stimulus(kind, state.level, state.contrast, state.frequency);
  result = simulate(state, light.t, light.light, CYCLES, seed);
  const { cutoff, delay } = response(state, state.level);
  const count = sign => (result.events.filter(([t, p]) => t >= cycle && p === sign).length / (CYCLES - 1)).toFixed(1);
  element("numbers").textContent = `At ${short(state.level)} ${state.unit}: ${cutoff < Infinity ? `cutoff ${hertz(cutoff)}` : "no cutoff"}, delay ` +
    `${prefixed(delay, "s")}; ${count(1)} ON and ${count(-1)} OFF events per cycle of ${prefixed(cycle, "s")}.`;
  draw();
}

// A plot over the time window, y from low to high: `marks` [y, text], `lines` of [x, y] points, `ticks` of events.
function plot(id, low, high, marks, lines, ticks = []) {
  const canvas = element(id), sharp = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * sharp; canvas.height = height * sharp;
  const pen = canvas.getContext("2d"), style = getComputedStyle(document.documentElement), left = 54;
  const ink = name => { pen.fillStyle = pen.strokeStyle = style.getPropertyValue(`--${name}`); };
  const X = t => left + (width - left) * (t * state.frequency - at) / SHOWN;
  const Y = y => height - 6 - (height - 12) * (y - low) / (high - low);
  pen.scale(sharp, sharp); pen.font = "12px system-ui, sans-serif"; pen.textAlign = "right"; pen.textBaseline = "middle";
  for (const [y, text] of marks) {
    ink("soft"); pen.fillText(text, left - 6, Math.min(Math.max(Y(y), 7), height - 7));
    ink("line"); pen.fillRect(left, Y(y), width - left, 1);
  }
  pen.beginPath(); pen.rect(left, 0, width - left, height); pen.clip();
  for (let c = Math.ceil(at); c <= at + SHOWN; c++) pen.fillRect(X(c / state.frequency), 0, 1, height);
  for (const { points, name, thick = 1.5, dash = [] } of lines) {
    ink(name); pen.lineWidth = thick; pen.setLineDash(dash); pen.beginPath();
    let gap = true;
    for (const [t, y] of points) {
      const inside = !Number.isNaN(y) && Math.abs(X(t)) < 2 * width;
      if (inside) gap ? pen.moveTo(X(t), Y(y)) : pen.lineTo(X(t), Y(y));
      gap = !inside;
    }
    pen.stroke();
  }
  for (const [t, sign] of ticks) { ink(sign > 0 ? "on" : "off"); pen.fillRect(X(t), sign > 0 ? Y(1) : Y(0), 1.5, Y(0) - Y(1)); }
}

function draw() {
  const n = light.t.length - 1, { signals, thresholds, events } = result, mark = x => x.toPrecision(2);
  const bright = signals.map(([t], k) => [t, Math.log(light.light[k % n])]), values = [...bright, ...signals].map(([, y]) => y);
  const low = Math.min(...values), high = Math.max(...values), room = 0.06 * (high - low) + 0.02;
  plot("light", low - room, high + room, [[low, short(Math.exp(low))], [high, short(Math.exp(high))]],
    [{ points: bright, name: "muted", thick: 3 }, { points: signals, name: "good", thick: 2 }]);
  const ends = [...thresholds.slice(1), [CYCLES / state.frequency]];
  const stairs = (k, sign) => thresholds.flatMap((now, i) => [[now[0], sign * now[k]], [ends[i][0], sign * now[k]], [0, NaN]]);
  plot("change", -1.25 * state.off, 1.25 * state.on, [[state.on, `+${mark(state.on)}`], [0, "0"], [-state.off, `−${mark(state.off)}`]],
    [{ points: stairs(1, 1), name: "on", dash: [5, 3] }, { points: stairs(2, -1), name: "off", dash: [5, 3] },
      { points: result.change, name: "ink" }]);
  plot("events", -1.1, 1.1, [[0.5, "ON"], [-0.5, "OFF"]], [], events);
}

function move(now) {
  if (playing) {
    at += Math.min(now - last, 100) / CYCLE_MS;
    if (at > CYCLES - SHOWN) at -= CYCLES - SHOWN - 1;
    draw();
  }
  last = now;
  requestAnimationFrame(move);
}

for (const control of CONTROLS) {
  const row = document.createElement("label"), input = document.createElement("input");
  Object.assign(input, { type: "range", max: 1000, id: control.field });
  input.addEventListener("input", () => { state[control.field] = scale(control).value(+input.value); compute(); });
  row.append(control.label, input, document.createElement("output"));
  element("controls").append(row);
}
presets.forEach(({ name }, k) => element("preset").append(new Option(name, k)));
element("preset").addEventListener("change", choose);
element("reset").addEventListener("click", choose);
for (const input of document.querySelectorAll("input[name=kind]")) input.addEventListener("change", compute);
const play = on => { playing = on; element("play").textContent = on ? "Pause" : "Play"; };
element("play").addEventListener("click", () => play(!playing));
element("draws").addEventListener("click", () => { seed += 1; compute(); });
addEventListener("resize", draw);
choose(); play(!matchMedia("(prefers-reduced-motion: reduce)").matches); requestAnimationFrame(move);
