// WebGL 2: shaded triangles, and lines of a width in pixels that lie on them.
const LIT = {
  vertex: `#version 300 es
    layout(location=0) in vec3 position; layout(location=1) in vec3 normal; layout(location=2) in vec3 colour;
    uniform mat4 matrix; out vec3 n; out vec3 base; out vec3 place;
    void main() { gl_Position = matrix * vec4(position, 1.0); n = normal; base = colour; place = position; }`,
  fragment: `#version 300 es
    precision highp float;
    in vec3 n; in vec3 base; in vec3 place; uniform vec3 eye, up, right; uniform float sheet, printed; uniform sampler2D image; out vec4 colour;
    void main() {
      vec3 own = printed > 0.5 ? texture(image, base.xy).rgb : base;
      vec3 v = normalize(eye - place);
      vec3 s = normalize(n) * (gl_FrontFacing ? 1.0 : -1.0);
      vec3 key = normalize(0.9 * v + 0.55 * up - 0.5 * right);
      float light = 0.34 + 0.62 * pow(max(dot(s, key), 0.0), 1.4) + 0.16 * (0.5 + 0.5 * dot(s, up));
      vec3 c = gl_FrontFacing || sheet < 0.5 ? own : mix(own, vec3(0.42, 0.5, 0.6), 0.6);
      float edge = pow(1.0 - abs(dot(s, v)), 3.0);
      colour = vec4(pow(c * light, vec3(1.0 / 1.1)) + 0.06 * edge, 1.0);
    }`,
};
const FLAT = {
  vertex: `#version 300 es
    layout(location=0) in vec3 position; layout(location=1) in vec4 colour;
    uniform mat4 matrix; uniform vec3 eye; uniform float lift; out vec4 tint;
    void main() { gl_Position = matrix * vec4(mix(position, eye, lift), 1.0); tint = colour; }`,
  fragment: `#version 300 es
    precision highp float; in vec4 tint; uniform vec4 over; uniform float fade; out vec4 colour;
    void main() { colour = over.a > 0.0 ? over : vec4(tint.rgb, tint.a * fade); }`,
};
const LINK = {
  vertex: `#version 300 es
    layout(location=0) in vec3 position; layout(location=2) in vec3 colour;
    uniform mat4 matrix; uniform float dot; out vec3 tint;
    void main() { gl_Position = matrix * vec4(position, 1.0); gl_PointSize = dot; tint = colour; }`,
  fragment: `#version 300 es
    precision highp float; in vec3 tint; out vec4 colour;
    void main() { colour = vec4(tint, 1.0); }`,
};
const FADE = {
  // What lies on the floor: a point goes down to it along the light.
  vertex: `#version 300 es
    layout(location=0) in vec3 position; uniform mat4 matrix; uniform vec3 light; uniform float height, lift; out vec3 place;
    void main() { place = position - light * (position.y - height) + vec3(0.0, lift, 0.0); gl_Position = matrix * vec4(place, 1.0); }`,
  fragment: `#version 300 es
    precision highp float; in vec3 place; uniform vec3 middle; uniform float reach; uniform vec4 tint; out vec4 colour;
    void main() { colour = vec4(tint.rgb, tint.a * (1.0 - smoothstep(0.15, 1.0, length(place.xz - middle.xz) / reach))); }`,
};
const RIBBON = {
  // A part of a line, from a to b, is a quad with two more corners at each end, which make a round cap.
  vertex: `#version 300 es
    layout(location=0) in vec2 corner; layout(location=1) in vec3 a; layout(location=2) in vec3 b; layout(location=3) in vec4 colour;
    uniform mat4 matrix; uniform vec3 eye; uniform vec2 size; uniform float width, lift; out vec4 tint; out vec2 off; out float along;
    void main() {
      vec4 p = matrix * vec4(mix(a, eye, lift), 1.0), q = matrix * vec4(mix(b, eye, lift), 1.0);
      vec2 d = (q.xy / q.w - p.xy / p.w) * size;
      along = length(d);
      vec2 t = along > 1e-4 ? d / along : vec2(1.0, 0.0);
      vec4 at = corner.x < 0.5 ? p : q;
      float end = corner.x < 0.5 ? -1.0 : 1.0;
      at.xy += (t * end + vec2(-t.y, t.x) * corner.y) * width / size * at.w;
      gl_Position = at; tint = colour; off = vec2(corner.x < 0.5 ? -width : along + width, corner.y * width);
    }`,
  fragment: `#version 300 es
    precision highp float; in vec4 tint; in vec2 off; in float along; uniform float width; uniform vec4 over; out vec4 colour;
    void main() {
      float d = length(vec2(off.x - clamp(off.x, 0.0, along), off.y));
      if (d > width) discard;
      colour = over.a > 0.0 ? over : tint;
    }`,
};
export const WIDTH = 2.6;
// Of a vertex that no triangle has, in pixels.
const DOT = 2.5;

/** Whether there is no graphics card: then edges are not smoothed, which would take most of a picture's time. */
function inSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), known = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = known ? gl.getParameter(known.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

export class Painter {
  constructor(canvas) {
    const gl = this.gl = canvas.getContext("webgl2", { antialias: !inSoftware(), alpha: false, stencil: true });
    if (!gl) throw new Error("no WebGL 2");
    this.canvas = canvas;
    this.lit = this.program(LIT); this.flat = this.program(FLAT); this.ribbon = this.program(RIBBON); this.link = this.program(LINK); this.fade = this.program(FADE);
    this.ground = [0.914, 0.929, 0.945];
    this.meshes = { cloth: this.mesh(), body: this.mesh(), print: this.mesh() };
    Object.assign(this, { printed: true, floor: null, square: this.array([[0, 3]]) });
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    this.parts = this.lines(); this.fins = this.array([[0, 3], [1, 4]]);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  program({ vertex, fragment }) {
    const gl = this.gl, p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(p, shader);
    }
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
    return { p, at: (name) => gl.getUniformLocation(p, name) };
  }

  mesh() {
    const gl = this.gl, vao = gl.createVertexArray(), buffers = [0, 1, 2].map(() => gl.createBuffer());
    gl.bindVertexArray(vao);
    buffers.forEach((buffer, i) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer); gl.enableVertexAttribArray(i); gl.vertexAttribPointer(i, 3, gl.FLOAT, false, 0, 0);
    });
    const [index, wires, links, dots] = [0, 1, 2, 3].map(() => gl.createBuffer());
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, index);
    gl.bindVertexArray(null);
    return { vao, buffers, index, wires, links, dots, count: 0, edges: 0, linked: 0, dotted: 0 };
  }

  /** Floats of one buffer, each row made of attributes [place, floats]. */
  array(attributes, step = 0, vao = this.gl.createVertexArray()) {
    const gl = this.gl, buffer = gl.createBuffer(), stride = 4 * attributes.reduce((sum, [, n]) => sum + n, 0);
    gl.bindVertexArray(vao); gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    let offset = 0;
    for (const [place, n] of attributes) {
      gl.enableVertexAttribArray(place); gl.vertexAttribPointer(place, n, gl.FLOAT, false, stride, offset);
      gl.vertexAttribDivisor(place, step); offset += 4 * n;
    }
    gl.bindVertexArray(null);
    return { vao, buffer, stride, count: 0 };
  }

  lines() {
    const gl = this.gl, corners = this.array([[0, 2]]);
    gl.bindBuffer(gl.ARRAY_BUFFER, corners.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([0, -1, 0, 1, 1, -1, 1, 1]), gl.STATIC_DRAW);
    return this.array([[1, 3], [2, 3], [3, 4]], 1, corners.vao);
  }

  setTopology(name, faces, colours) {
    const gl = this.gl, mesh = this.meshes[name], pairs = new Uint32Array(2 * faces.length);
    for (let i = 0; i < faces.length; i += 3)
      for (let k = 0; k < 3; k++) { pairs[2 * (i + k)] = faces[i + k]; pairs[2 * (i + k) + 1] = faces[i + (k + 1) % 3]; }
    gl.bindVertexArray(mesh.vao);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.wires); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, pairs, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.index); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
    this.fill(mesh.buffers[2], colours);
    gl.bindVertexArray(null);
    mesh.count = faces.length; mesh.edges = pairs.length;
  }

  /** Take the image of what is printed. */
  print(image) {
    const gl = this.gl;
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
  }

  move(name, x, normals) { this.fill(this.meshes[name].buffers[0], x); this.fill(this.meshes[name].buffers[1], normals); }

  /** What of the cloth no triangle has: pairs of vertices as lines, and vertices as dots. */
  setLinks(pairs, loose) {
    const gl = this.gl, mesh = this.meshes.cloth;
    gl.bindVertexArray(mesh.vao);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.links); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, pairs, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.dots); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, loose, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    mesh.linked = pairs.length; mesh.dotted = loose.length;
  }

  /** A floor that fades into the distance, and on it the shadow of all that stands or hangs above, by light from the left and the eye's side. */
  drawFloor(use, { target, size }, right) {
    const gl = this.gl, { floor, ground } = this, far = 4 * size, [x, , z] = target, dark = ground[0] < 0.5;
    this.fill(this.square.buffer, new Float32Array([[-far, -far], [far, -far], [-far, far], [far, far]].flatMap(([a, b]) => [x + a, floor, z + b])));
    gl.enable(gl.BLEND); gl.enable(gl.STENCIL_TEST); gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR); gl.depthMask(false);
    const common = { height: floor, middle: [x, floor, z], reach: far, light: [-0.4 * right[0] - 0.25 * right[2], 1, -0.4 * right[2] + 0.25 * right[0]] };
    use(this.fade, { ...common, lift: 0, tint: [...ground.map((c) => c * (dark ? 1.35 : 0.93)), 0.9] });
    gl.stencilFunc(gl.ALWAYS, 0, 255); gl.stencilMask(0); gl.bindVertexArray(this.square.vao); gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    use(this.fade, { ...common, lift: 5e-4 * size, tint: [0, 0, 0, dark ? 0.4 : 0.2] });
    gl.stencilMask(255); gl.stencilFunc(gl.EQUAL, 0, 255);  // each pixel is dark once
    for (const mesh of [this.meshes.cloth, this.meshes.body]) { gl.bindVertexArray(mesh.vao); gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.index); gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0); }
    gl.disable(gl.STENCIL_TEST); gl.disable(gl.BLEND); gl.depthMask(true);
  }

  drawLinks(use, ratio) {
    const gl = this.gl, mesh = this.meshes.cloth;
    if (!mesh.dotted) return;
    use(this.link, { dot: DOT * ratio });
    gl.bindVertexArray(mesh.vao);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.links); gl.drawElements(gl.LINES, mesh.linked, gl.UNSIGNED_INT, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.dots); gl.drawElements(gl.POINTS, mesh.dotted, gl.UNSIGNED_INT, 0);
  }

  /** Let the browser have back what it holds for this. */
  close() { this.gl.getExtension("WEBGL_lose_context")?.loseContext(); }

  /** Three numbers of each vertex, until there are other triangles. */
  colour(name, colours) { this.fill(this.meshes[name].buffers[2], colours); }

  fill(buffer, values) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, buffer);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, values, this.gl.DYNAMIC_DRAW);
  }

  setLines(parts, fins) {
    this.fill(this.parts.buffer, new Float32Array(parts)); this.parts.count = parts.length / 10;
    this.fill(this.fins.buffer, new Float32Array(fins)); this.fins.count = fins.length / 7;
  }

  draw(camera, wires) {
    const gl = this.gl, { canvas } = this, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const w = Math.round(camera.width * ratio), h = Math.round(camera.height * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    gl.viewport(0, 0, w, h);
    gl.clearColor(...this.ground, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    const matrix = camera.matrix(), { right, up } = camera.axes(), eye = camera.eye;
    const use = ({ p, at }, more) => {
      gl.useProgram(p); gl.uniformMatrix4fv(at("matrix"), false, matrix); gl.uniform3fv(at("eye"), eye);
      for (const [name, value] of Object.entries(more))
        gl[`uniform${Array.isArray(value) ? value.length : 1}fv`](at(name), [].concat(value));
    };
    for (const [name, mesh] of Object.entries(this.meshes)) {
      if (name === "print") { if (!this.printed) continue; gl.depthFunc(gl.LEQUAL); }  // over the same triangles of the cloth
      use(this.lit, { right, up, sheet: name === "body" ? 0 : 1, printed: name === "print" ? 1 : 0 });
      gl.bindVertexArray(mesh.vao);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.index);
      // Bodies are behind cloth that lies on them. Cloth itself is not pushed back: where it is steep, as in a fold, that
      // would be by more than it is thick. What lies on it, lines and edges, is lifted.
      if (name === "body") { gl.enable(gl.POLYGON_OFFSET_FILL); gl.polygonOffset(1, 1); }
      gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
      gl.disable(gl.POLYGON_OFFSET_FILL);
    }
    gl.depthFunc(gl.LESS);
    if (this.floor !== null && eye[1] > this.floor) this.drawFloor(use, camera, right);
    this.drawLinks(use, ratio);
    gl.enable(gl.BLEND);
    if (wires) {
      const mesh = this.meshes.cloth;
      use(this.flat, { lift: 0.0005, over: [0.15, 0.2, 0.25, 0.22] });
      gl.bindVertexArray(mesh.vao); gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.wires);
      gl.disableVertexAttribArray(1); gl.drawElements(gl.LINES, mesh.edges, gl.UNSIGNED_INT, 0); gl.enableVertexAttribArray(1);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.index);
    }
    gl.depthMask(false);
    // What is hidden, as a valley's curtain is from outside, shows through faintly.
    for (const [depth, fade] of [[gl.LESS, 1], [gl.GREATER, 0.45]]) {
      gl.depthFunc(depth);
      use(this.flat, { lift: 0, over: [0, 0, 0, 0], fade });
      gl.bindVertexArray(this.fins.vao);
      gl.drawArrays(gl.TRIANGLES, 0, this.fins.count);
    }
    gl.depthFunc(gl.LESS);
    gl.bindVertexArray(this.parts.vao);
    const size = [w / 2, h / 2];
    for (const [width, over, lift] of [[WIDTH + 1.7, [1, 1, 1, 1], 0.003], [WIDTH, [0, 0, 0, 0], 0.0036]]) {
      use(this.ribbon, { size, width: width * ratio, lift, over });
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.parts.count);
      gl.depthMask(true);
    }
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
  }
}
