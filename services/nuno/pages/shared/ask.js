/** What tells this page from others. */
export const PAGE = crypto.randomUUID();

/** Ask the server to do something; its answer, with ok false where it refused. */
export async function ask(action, more = {}, signal) {
  try {
    const answer = await fetch("do", {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ do: action, ...more }), signal,
    });
    return answer.ok ? await answer.json() : { ok: false, problem: (await answer.text()).trim() };
  } catch {
    return { ok: false, gone: true, problem: "nuno does not answer", remedy: "Is it still running in its terminal? What you made stays here." };
  }
}
