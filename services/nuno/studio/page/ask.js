/** What tells this page from others. */
export const PAGE = crypto.randomUUID();

/** Ask the server to do something; its answer, with ok false where it refused. */
export async function ask(action, more = {}, how = {}) {
  try {
    const answer = await fetch("do", {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ do: action, ...more }), ...how,
    });
    if (answer.status === 403) return { ok: false, gone: true, problem: "nuno was started anew, and has another address", remedy: "Open the one that its terminal says. What you made stays here." };
    return answer.ok ? await answer.json() : { ok: false, problem: (await answer.text()).trim() };
  } catch {
    return { ok: false, gone: true, problem: "nuno does not answer", remedy: "Is it still running in its terminal? What you made stays here." };
  }
}
