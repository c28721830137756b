const head = JSON.parse(document.getElementById("scene").textContent), element = id => document.getElementById(id);
const splats = unpack(head, Uint8Array.from(atob(document.getElementById("splats").textContent.trim()), c => c.charCodeAt(0)));
const [width, height] = [240, 180], focal = 0.5 * width / Math.tan(head.fov / 2), pixels = width * height;
const screens = ["view", "depth", "events"].map(id => element(id).getContext("2d")), pictures = screens.map(s => s.createImageData(width, height));
const keys = new Set(), reference = new Float32Array(pixels), glow = new Float32Array(pixels);
let pose, flying = true, turn = 0, fresh = true, moved = true, last = 0, total = 0;
const reset = () => { turn = 0; pose = { ...head.start, position: [...head.start.position] }; fresh = moved = true; };
const orbit = angle => {  /* one turn around the middle at the height and distance of the start */
  const { yaw, pitch } = head.start, back = head.distance;
  const way = cameraOf({ position: [0, 0, 0], yaw: yaw + angle, pitch }).forward;
  pose = { yaw: yaw + angle, pitch, position: head.middle.map((m, k) => m - back * way[k]) };
};
/* Eight colours from dark blue to yellow, as viridis has them. */
const ramp = [[68, 1, 84], [70, 51, 126], [54, 92, 141], [39, 127, 142], [31, 161, 135], [74, 193, 109], [160, 218, 57], [253, 231, 37]];
const shade = share => { const at = Math.min(Math.max(share, 0), 1) * 6.999, k = at | 0; return ramp[k].map((c, j) => c + (at - k) * (ramp[k + 1][j] - c)); };
function draw() {
  const camera = cameraOf(pose), begun = performance.now(), { rgb, light, depth } = render(splats, camera, width, height, focal);
  const [on, off] = [head.on, head.off].map(t => t * 2 ** element("threshold").valueAsNumber);
  if (fresh) for (let q = 0; q < pixels; q++) { reference[q] = Math.log(light[q] + head.dark); glow[q] = 0; }
  fresh = false;
  const counts = eventsOf(light, reference, on, off, head.dark);
  let near = Infinity, far = 0, number = 0;
  for (const d of depth) { if (d < near) near = d; if (d > far) far = d; }
  for (let q = 0; q < pixels; q++) {
    number += Math.abs(counts[q]);
    glow[q] = counts[q] ? Math.sign(counts[q]) : 0.75 * glow[q];
    const deep = depth[q] === depth[q] ? shade(1 - (depth[q] - near) / Math.max(far - near, 1e-9)) : [30, 30, 34];
    const fade = Math.abs(glow[q]), event = (glow[q] > 0 ? [245, 138, 60] : [88, 169, 232]).map(c => 24 + fade * (c - 24));
    [[rgb[3 * q], rgb[3 * q + 1], rgb[3 * q + 2]], deep, event].forEach((colour, k) => { pictures[k].data.set([...colour, 255], 4 * q); });
  }
  screens.forEach((screen, k) => screen.putImageData(pictures[k], 0, 0));
  total += number;
  const reach = far > 0 ? `, ${near.toPrecision(3)} to ${far.toPrecision(3)} away` : "";
  element("numbers").textContent = `${splats.n} splats${reach}; ${number} events in this picture at ON ${on.toPrecision(2)}, OFF ${off.toPrecision(2)}; ${Math.round(performance.now() - begun)} ms`;
}
const act = {  /* by key: along the camera's own axes */
  w: ["forward", 1], s: ["forward", -1], d: ["right", 1], a: ["right", -1], e: ["down", -1], q: ["down", 1],
  ArrowUp: ["forward", 1], ArrowDown: ["forward", -1], ArrowRight: ["right", 1], ArrowLeft: ["right", -1],
};
const step = (axis, by) => {
  const along = cameraOf(pose)[axis];
  pose.position = pose.position.map((c, k) => c + by * along[k]); moved = true;
};
const still = () => { flying = false; element("fly").textContent = "Fly around"; };
function tick(now) {
  const dt = Math.min((now - last) / 1000, 0.1); last = now;
  if (flying) { turn += 0.5 * dt; orbit(turn); moved = true; }
  for (const key of keys) if (act[key]) step(act[key][0], act[key][1] * dt * head.distance * 0.5);
  if (moved || glow.some(g => g)) { draw(); for (let q = 0; q < pixels; q++) if (Math.abs(glow[q]) < 0.05) glow[q] = 0; }
  moved = false;
  requestAnimationFrame(tick);
}
addEventListener("keydown", event => { if (act[event.key] && !event.target.closest("input")) { keys.add(event.key); still(); event.preventDefault(); } });
addEventListener("keyup", event => keys.delete(event.key));
addEventListener("blur", () => keys.clear());
for (const { canvas } of screens) {
  canvas.addEventListener("pointerdown", event => { still(); canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointermove", event => {
    if (!event.buttons) return;
    const per = head.fov / canvas.clientWidth;
    pose.yaw += event.movementX * per; moved = true;
    pose.pitch = Math.max(-1.5, Math.min(1.5, pose.pitch + event.movementY * per));
  });
  canvas.addEventListener("wheel", event => { event.preventDefault(); still(); step("forward", -Math.sign(event.deltaY) * head.distance * 0.04); }, { passive: false });
}
for (const button of document.querySelectorAll("[data-step]")) button.addEventListener("click", () => {
  const [axis, by] = button.dataset.step.split(" "); still(); step(axis, by * head.distance * 0.08); });
element("fly").addEventListener("click", () => { if (flying) return still(); flying = true; element("fly").textContent = "Pause"; });
element("reset").addEventListener("click", () => { still(); reset(); });
element("threshold").addEventListener("input", () => { fresh = moved = true; });
reset(); requestAnimationFrame(tick);
