/** Pixels around the cloth. */
const RIM = 12;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** Cloth that lies flat, seen from above, and a brush that is drawn over it by mouse, pen, finger or keys. */
export class Flat {
  /** paint: its `width` [m], `look_of_brush`, `tool`, `image` and `put(points)`; places are [m] from the upper left corner. */
  constructor(canvas, paint) {
    Object.assign(this, { canvas, owner: paint, at: null, line: null, waiting: [], size: [1, 1] });
    canvas.addEventListener("pointerdown", (e) => this.begin(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    canvas.addEventListener("pointerup", (e) => this.end(e));
    canvas.addEventListener("pointercancel", () => this.cancel());
    canvas.addEventListener("pointerleave", () => { if (!this.line) { this.at = null; this.paint(); } });
    canvas.addEventListener("keydown", (e) => this.key(e));
    new ResizeObserver(() => this.paint()).observe(canvas);
  }

  show(image, size) { Object.assign(this, { image, size }); this.paint(); }

  /** Pixels of a metre, and of the cloth's corner. */
  get frame() {
    const { clientWidth: w, clientHeight: h } = this.canvas, [wide, high] = this.size;
    const scale = Math.max(1e-9, Math.min((w - 2 * RIM) / wide, (h - 2 * RIM) / high));
    return { scale, left: (w - scale * wide) / 2, top: (h - scale * high) / 2 };
  }

  place(e) {
    const { scale, left, top } = this.frame;
    return [(e.offsetX - left) / scale, (e.offsetY - top) / scale];
  }

  begin(e) {
    if (e.button !== 0) return;
    this.canvas.setPointerCapture(e.pointerId);
    this.line = [this.at = this.place(e)];
    this.paint();
  }

  move(e) {
    this.at = this.place(e);
    // All that a pen or a fast mouse has been through, not only where it is at each picture.
    if (this.line) this.line.push(...(e.getCoalescedEvents?.() ?? []).map((one) => this.place(one)), this.at);
    this.paint();
  }

  end(e) {
    if (!this.line) return;
    this.at = this.place(e);
    this.finish();
  }

  async finish() {
    const stroke = { points: this.line, width: this.owner.width, tool: this.owner.tool, ...this.owner.look_of_brush };
    this.line = null;
    if (stroke.tool !== "stencil") this.waiting.push(stroke);
    this.paint();
    await this.owner.put(stroke.points);
    this.waiting = this.waiting.filter((one) => one !== stroke);
    this.paint();
  }

  /** Let go of a stroke that was begun; whether one was. */
  cancel() {
    const had = this.line !== null;
    this.line = null;
    this.paint();
    return had;
  }

  key(e) {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const way = ARROWS[e.key], step = (e.shiftKey ? 1 : 0.25) * this.owner.width;
    if (way) {
      const from = this.at ?? this.size.map((length) => length / 2);
      this.at = from.map((x, i) => Math.min(this.size[i], Math.max(0, x + step * way[i])));
      this.line?.push(this.at);
      this.paint();
    } else if (e.key === "Enter") {
      this.at ??= this.size.map((length) => length / 2);
      if (this.line || this.owner.tool === "stencil") { this.line ??= [this.at]; this.finish(); } else { this.line = [this.at]; this.paint(); }
    } else return;
    e.preventDefault();
  }

  paint() {
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => { this.asked = 0; this.draw(); });
  }

  draw() {
    const { canvas, image, at, owner } = this, ratio = devicePixelRatio, { scale, left, top } = this.frame;
    if (!image || !canvas.clientWidth) return;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    const pen = canvas.getContext("2d"), [wide, high] = this.size;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.imageSmoothingEnabled = image.naturalWidth > scale * wide * ratio;
    pen.shadowColor = "#0004"; pen.shadowBlur = 8;
    pen.drawImage(image, left, top, scale * wide, scale * high);
    pen.shadowBlur = 0;
    pen.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * left, ratio * top);
    pen.save();
    pen.beginPath(); pen.rect(0, 0, wide, high); pen.clip();
    for (const stroke of this.waiting) this.trace(pen, stroke);
    if (this.line && owner.tool !== "stencil") this.trace(pen, { points: this.line, width: owner.width, ...owner.look_of_brush });
    pen.restore();
    if (at) this.outline(pen, at, 1 / scale);
    const told = document.getElementById("paint-place");
    told.textContent = at ? at.map((x) => (1000 * x).toFixed(2)).join(", ") + " mm" : "";
  }

  trace(pen, { points, width, colour, opacity }) {
    pen.globalAlpha = opacity;
    Object.assign(pen, { strokeStyle: colour, lineWidth: width, lineCap: "round", lineJoin: "round" });
    pen.beginPath();
    pen.moveTo(...points[0]);
    for (const point of points.slice(points.length > 1 ? 1 : 0)) pen.lineTo(...point);
    pen.stroke();
    pen.globalAlpha = 1;
  }

  /** What the brush or the stencil would touch. */
  outline(pen, [x, y], pixel) {
    const { width, tool, image } = this.owner, high = width * (image?.ratio ?? 1);
    if (tool === "stencil" && image) {
      pen.globalAlpha = 0.45;
      pen.drawImage(image.shown, x - width / 2, y - high / 2, width, high);
      pen.globalAlpha = 1;
    }
    for (const [colour, line] of [["#fff", 3], ["#222", 1.2]]) {
      Object.assign(pen, { strokeStyle: colour, lineWidth: line * pixel });
      pen.beginPath();
      if (tool === "stencil") pen.rect(x - width / 2, y - high / 2, width, high);
      else pen.arc(x, y, width / 2, 0, 2 * Math.PI);
      pen.stroke();
    }
  }
}
