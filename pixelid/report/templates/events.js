/* Events in a box of column, row and time, which a drag turns; the polarities can be hidden. */
{
  const { t, x, y, p, width, height, span } = JSON.parse(document.getElementById("event-data").textContent);
  const figure = document.querySelector("figure.events"), canvas = figure.querySelector("canvas"), screen = canvas.getContext("2d");
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  let yaw = -0.5, pitch = 0.35;
  const draw = () => {
    const sharp = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    canvas.width = w * sharp; canvas.height = h * sharp;
    screen.setTransform(sharp, 0, 0, sharp, 0, 0);
    const size = Math.min(w / 2.7, h / 1.9), largest = Math.max(width, height), [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
    const place = (time, column, row) => {  /* time to the right, rows down, columns into the depth */
      const a = 2 * time - 1, b = (column - 0.5 * width) / largest, c = (row - 0.5 * height) / largest, deep = a * sy + b * cy;
      return [w / 2 + size * (a * cy - b * sy), h / 2 + size * (c * cp + deep * sp)];
    };
    screen.strokeStyle = screen.fillStyle = colour("--soft"); screen.lineWidth = 0.7;
    const corner = [0, 1].flatMap(a => [0, width].flatMap(b => [0, height].map(c => place(a, b, c))));
    for (const [a, b] of [[0, 1], [0, 2], [1, 3], [2, 3], [4, 5], [4, 6], [5, 7], [6, 7], [0, 4], [1, 5], [2, 6], [3, 7]]) {
      screen.beginPath(); screen.moveTo(...corner[a]); screen.lineTo(...corner[b]); screen.stroke();
    }
    for (const [polarity, name] of [[0, "--off"], [1, "--on"]]) {
      if (!figure.querySelector(`input[value="${polarity}"]`).checked) continue;
      screen.fillStyle = colour(name);
      for (let k = 0; k < t.length; k++) if (p[k] === polarity) {
        const [u, v] = place(t[k] / 1000, x[k] + 0.5, y[k] + 0.5);
        screen.fillRect(u - 1, v - 1, 2, 2);
      }
    }
    screen.font = "13px system-ui, sans-serif"; screen.textAlign = "center"; screen.lineWidth = 4;
    screen.fillStyle = colour("--ink"); screen.strokeStyle = colour("--paper");
    for (const [text, a, b] of [[`time, ${span}`, 1, 5], [`${width} columns`, 5, 7], [`${height} rows`, 4, 5]]) {
      const u = (corner[a][0] + corner[b][0]) / 2, v = (corner[a][1] + corner[b][1]) / 2 + 16;
      screen.strokeText(text, u, v); screen.fillText(text, u, v);
    }
  };
  canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", event => {
    if (!event.buttons) return;
    yaw += event.movementX * 0.01; pitch = Math.max(-1.5, Math.min(1.5, pitch + event.movementY * 0.01)); draw();
  });
  for (const box of figure.querySelectorAll("input")) box.addEventListener("change", draw);
  addEventListener("resize", draw); matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
}
