// The pixel of docs/model.md: light in, events out.  Plain arithmetic, no page; exact at samples for a logarithm of the
// light that is linear between them, with the photoreceptor linearised at the middle of each step.
"use strict";

const FAST = 1e7;  // rad/s of a stage that is absent: it follows within 0.1 µs
const PARTS = 4;  // of a step, at whose ends the change is compared
const MOST = 50000;  // events
const LEAST = 0.01;  // relative threshold: lower draws are repeated

function product(A, B) {
  const C = new Float64Array(36);
  for (let i = 0; i < 6; i++) for (let k = 0; k < 6; k++) {
    const a = A[6 * i + k];
    if (a !== 0) for (let j = 0; j < 6; j++) C[6 * i + j] += a * B[6 * k + j];
  }
  return C;
}

// e^A of a 6 × 6 matrix: Taylor's series of A / 2^n, squared n times.
function exponential(A) {
  const halvings = Math.max(0, Math.ceil(Math.log2(12 * Math.max(...A.map(Math.abs)))));
  const small = A.map(a => a / 2 ** halvings);
  let sum = new Float64Array(36), term = new Float64Array(36);
  for (let i = 0; i < 6; i++) sum[7 * i] = term[7 * i] = 1;
  for (let k = 1; k <= 12; k++) {
    term = product(term, small).map(a => a / k);
    sum = sum.map((a, i) => a + term[i]);
  }
  for (let k = 0; k < halvings; k++) sum = product(sum, sum);
  return sum;
}

// Natural frequency and damping (second order), or the corner of one pole, in rad/s, under light L.
function rates(p, L) {
  if (p.photoreceptor === "second_order")
    return { natural: p.bandwidth * Math.sqrt(p.alpha * L), damping: p.bandwidth * (p.beta + p.gamma * L) };
  return { corner: p.photoreceptor === "one_pole" ? p.bandwidth * p.corner * L : FAST };
}

// A step of h seconds of the state [dy/dt / natural, y, source follower, amplifier, u, change of u in the step].
function transition(p, L, h) {
  const A = new Float64Array(36), { natural, damping, corner } = rates(p, L);
  if (corner === undefined) { A[0] = -damping * h; A[1] = -natural * h; A[4] = A[6] = natural * h; }
  else { A[7] = -corner * h; A[10] = corner * h; }
  A[13] = p.follower * h; A[14] = -A[13];
  A[20] = p.differencing * h; A[21] = -A[20];
  A[29] = 1;
  return { E: exponential(A), natural: natural || 1, corner };
}

// Standard normal numbers of a seed: mulberry32, Box & Muller.
function normals(seed) {
  let state = Math.imul(seed, 0x9E3779B1) >>> 0;
  const uniform = () => {
    state = (state + 0x6D2B79F5) >>> 0;
    let z = Math.imul(state ^ (state >>> 15), state | 1);
    z ^= z + Math.imul(z ^ (z >>> 7), z | 61);
    return ((z ^ (z >>> 14)) >>> 0) / 2 ** 32;
  };
  return () => Math.sqrt(-2 * Math.log(1 - uniform())) * Math.cos(2 * Math.PI * uniform());
}

// A cubic on 0 … 1 by its values and slopes at both ends.
function cubic(a, b, slopeA, slopeB) {
  return z => (1 - z) ** 2 * (a * (1 + 2 * z) + slopeA * z) + z * z * (b * (3 - 2 * z) - slopeB * (1 - z));
}

// Events [time s, ±1] of one pixel, and its signals, under light (radiance) at times t, repeated `cycles` times.
// It begins in the steady state of the first sample, with its reference there.
function simulate(p, t, light, cycles = 1, seed = 1) {
  const n = t.length - 1, period = t[n] - t[0], seen = light.map(L => L + p.dark), u = seen.map(Math.log);
  const steps = [];
  for (let k = 0; k < n; k++) steps.push(transition(p, Math.sqrt(seen[k] * seen[k + 1]), t[k + 1] - t[k]));
  const normal = normals(seed), follower = p.follower, wd = p.differencing, drift = p.leak * p.on;
  const draw = () => { for (;;) { const x = 1 + p.noise * normal(); if (x >= LEAST) return x; } };
  let x = [0, u[0], u[0], u[0], u[0], 0], on = p.on * draw(), off = p.off * draw();
  let level = u[0], gap = 0, from = t[0], release = null;
  const events = [], signals = [[t[0], u[0], u[0]]], change = [[t[0], 0]], thresholds = [[t[0], on, off]];
  for (let c = 0; c < cycles; c++) for (let k = 0; k < n; k++) {
    const start = t[k] + c * period, h = t[k + 1] - t[k], { E, natural, corner } = steps[k], before = x;
    before[0] /= natural; before[4] = u[k]; before[5] = u[k + 1] - u[k];
    x = [0, 0, 0, 0, 0, 0];
    for (let i = 0; i < 4; i++) for (let j = 0; j < 6; j++) x[i] += E[6 * i + j] * before[j];
    x[0] *= natural;
    const y = corner === FAST ? z => u[k] + z * (u[k + 1] - u[k]) : corner
      ? cubic(before[1], x[1], h * corner * (u[k] - before[1]), h * corner * (u[k + 1] - x[1]))
      : cubic(before[1], x[1], h * natural * before[0], h * x[0]);
    const s = follower >= FAST ? y
      : cubic(before[2], x[2], h * follower * (before[1] - before[2]), h * follower * (x[1] - x[2]));
    const d = wd >= FAST ? s : cubic(before[3], x[3], h * wd * (before[2] - before[3]), h * wd * (x[2] - x[3]));
    signals.push([start + h, x[2], x[3]]);
    const since = z => start + z * h - from;
    const moved = z => d(z) - level - gap * Math.exp(-wd * since(z)) + drift * since(z);
    let z = 0;
    while (events.length < MOST) {
      if (release !== null) {  // held in reset
        if (release > start + h) break;
        z = Math.max(z, (release - start) / h);
        level = s(z); gap = d(z) - level; from = release; release = null;
        change.push([from, 0]);
      }
      let crossed = 0, a = z, b = z;
      for (let i = 1; i <= PARTS && !crossed; i++) {
        a = b; b = z + (1 - z) * i / PARTS;
        const now = moved(b);
        crossed = now >= on ? 1 : -now >= off ? -1 : 0;
      }
      if (!crossed) { change.push([start + h, moved(1)]); break; }
      const threshold = crossed > 0 ? on : off;
      for (let i = 0; i < 45; i++) {
        const middle = (a + b) / 2;
        if (crossed * moved(middle) >= threshold) b = middle; else a = middle;
      }
      z = b;
      const when = start + z * h;
      events.push([when, crossed]);
      change.push([when, crossed * threshold], [when, NaN]);
      on = p.on * draw(); off = p.off * draw();
      thresholds.push([when, on, off]);
      release = when + p.dead;
    }
  }
  for (const event of events) event[0] += p.delay;
  return { events, signals, change, thresholds };
}

// Of small signals around light L: the frequency (Hz) where half of the power is left, and the delay (s) of slow ones.
function response(p, L) {
  const { natural, damping, corner } = rates(p, L + p.dark);
  const poles = [corner, p.follower, p.differencing].filter(pole => pole < FAST);
  const delay = poles.reduce((sum, pole) => sum + 1 / pole, p.delay + (natural ? damping / natural ** 2 : 0));
  if (!natural && !poles.length) return { cutoff: Infinity, delay };
  const power = w => poles.reduce((left, pole) => left / (1 + (w / pole) ** 2),
    natural ? natural ** 4 / ((natural ** 2 - w * w) ** 2 + (damping * w) ** 2) : 1);
  let low = 1e-6, high = low;
  while (power(high) >= 0.5) { low = high; high *= 1.02; }
  for (let i = 0; i < 50; i++) { const w = (low + high) / 2; if (power(w) >= 0.5) low = w; else high = w; }
  return { cutoff: low / (2 * Math.PI), delay };
}

// One period of light from `level`, {t, light}: a sine, or steps down and up with samples crowded after each edge.
function stimulus(kind, level, contrast, frequency) {
  const period = 1 / frequency, t = [];
  if (kind === "sine") {
    for (let k = 0; k <= 400; k++) t.push(k * period / 400);
    return { t, light: t.map((_, k) => level * (1 + contrast * Math.sin(2 * Math.PI * k / 400))) };
  }
  const edge = period / 4000;
  for (const middle of [period / 4, 3 * period / 4]) {
    for (let k = 0; k < 20; k++) t.push(middle - 6 * edge - (period / 4 - 6 * edge) * (1 - k / 20));
    for (let after = -6 * edge; after < 0.24 * period; after += Math.max(edge / 10, 0.06 * after)) t.push(middle + after);
  }
  t.push(period);
  const height = x => Math.tanh((x - period / 4) / edge) - Math.tanh((x - 3 * period / 4) / edge) - 1;
  return { t, light: t.map(x => level * (1 + contrast * height(x))) };
}

if (typeof module !== "undefined") module.exports = { simulate, response, stimulus };
