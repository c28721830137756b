/* Gaussian splats blended front to back on a CPU: colours, radiance and depth of a view, and the events of its change. */
const unpack = (head, bytes) => {
  const n = head.count, fine = new Uint16Array(bytes.buffer, 0, 5 * n), coarse = new Uint8Array(bytes.buffer, 10 * n, 4 * n);
  const at = new Float32Array(3 * n), log = new Float32Array(n), size = new Float32Array(n);
  for (let k = 0; k < n; k++) {
    const [x, y, z, l, s] = head.ranges.map(([low, high], j) => low + (high - low) * fine[5 * k + j] / 65535);
    at.set([x, y, z], 3 * k); log[k] = Math.exp(l); size[k] = Math.exp(s);
  }
  return { n, at, radiance: log, size, paint: coarse, background: head.background };
};
const fall = Float32Array.from({ length: 1025 }, (_, k) => Math.exp(-4.5 * k / 1024));  /* of a Gaussian, to 3 deviations */
const cameraOf = ({ position, yaw, pitch }) => {  /* z is up */
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return { position, right: [sy, -cy, 0], down: [cy * sp, sy * sp, -cp], forward: [cy * cp, sy * cp, sp] };
};
function render(splats, camera, width, height, focal) {
  const { n, at, radiance, size, paint, background } = splats, { position: p, right, down, forward } = camera;
  const pixels = width * height, left = new Float32Array(pixels).fill(1);
  const rgb = new Float32Array(3 * pixels), light = new Float32Array(pixels), depth = new Float32Array(pixels);
  const z = new Float32Array(n), shown = [];
  let nearest = Infinity, farthest = 0;
  for (let k = 0; k < n; k++) {
    const d = (at[3 * k] - p[0]) * forward[0] + (at[3 * k + 1] - p[1]) * forward[1] + (at[3 * k + 2] - p[2]) * forward[2];
    if (d < 2 * size[k]) continue;
    z[k] = d; shown.push(k);
    if (d < nearest) nearest = d;
    if (d > farthest) farthest = d;
  }
  const bins = 8192, scale = (bins - 1) / Math.max(farthest - nearest, 1e-12), counts = new Uint32Array(bins + 1), order = new Uint32Array(shown.length);
  for (const k of shown) counts[1 + Math.floor((z[k] - nearest) * scale)]++;
  for (let b = 0; b < bins; b++) counts[b + 1] += counts[b];
  for (const k of shown) order[counts[Math.floor((z[k] - nearest) * scale)]++] = k;
  for (const k of order) {
    const [x, y, d] = [at[3 * k] - p[0], at[3 * k + 1] - p[1], at[3 * k + 2] - p[2]];
    const u = width / 2 + focal * (x * right[0] + y * right[1] + d * right[2]) / z[k];
    const v = height / 2 + focal * (x * down[0] + y * down[1] + d * down[2]) / z[k];
    const s2 = (focal * size[k] / z[k]) ** 2 + 0.1, reach = Math.min(3 * Math.sqrt(s2), 60);
    if (u < -reach || v < -reach || u > width + reach || v > height + reach) continue;
    const opacity = paint[4 * k + 3] / 255, step = 1024 / (9 * s2);
    for (let j = Math.max(0, Math.ceil(v - reach - 0.5)); j <= Math.min(height - 1, v + reach - 0.5); j++) {
      for (let i = Math.max(0, Math.ceil(u - reach - 0.5)); i <= Math.min(width - 1, u + reach - 0.5); i++) {
        const q = j * width + i, r = ((i + 0.5 - u) ** 2 + (j + 0.5 - v) ** 2) * step;
        if (r > 1024 || left[q] < 0.004) continue;
        const w = left[q] * opacity * fall[r | 0];
        left[q] -= w; light[q] += w * radiance[k]; depth[q] += w * z[k];
        rgb[3 * q] += w * paint[4 * k]; rgb[3 * q + 1] += w * paint[4 * k + 1]; rgb[3 * q + 2] += w * paint[4 * k + 2];
      }
    }
  }
  for (let q = 0; q < pixels; q++) {
    depth[q] = left[q] < 0.5 ? depth[q] / (1 - left[q]) : NaN;
    light[q] += left[q] * background.radiance;
    for (let c = 0; c < 3; c++) rgb[3 * q + c] += left[q] * background.colour[c];
  }
  return { rgb, light, depth };
}
/* Events of every pixel since its reference, which moves by whole thresholds; returns counts, OFF negative. */
function eventsOf(light, reference, on, off, dark) {
  const counts = new Int16Array(light.length);
  for (let q = 0; q < light.length; q++) {
    const change = Math.log(light[q] + dark) - reference[q];
    const n = change >= on ? Math.floor(change / on) : change <= -off ? -Math.floor(-change / off) : 0;
    counts[q] = n; reference[q] += n > 0 ? n * on : n * off;
  }
  return counts;
}
if (typeof module !== "undefined") module.exports = { unpack, cameraOf, render, eventsOf };
