// The explorer as a page of its own: it asks the server that it came from.
import { mount } from "./explorer.js";

const token = new URLSearchParams(location.search).get("token") ?? "";

async function ask(message) {
  let response;
  try {
    response = await fetch("ask", {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-Beamfield-Token": token },
      body: JSON.stringify(message),
    });
  } catch {
    throw new Error("beamfield explore does not answer any more: start it again");
  }
  const answer = await response.json();
  if (!response.ok) throw new Error(answer.error ?? `status ${response.status}`);
  return answer;
}

// A place in the log, so that a link to it can be copied: #i=12&x=1.5&y=2&heading=0.3&set=1
const place = {
  read() {
    const words = new URLSearchParams(location.hash.slice(1));
    const number = (name) => (words.has(name) && Number.isFinite(Number(words.get(name))) ? Number(words.get(name)) : null);
    const pose = ["x", "y", "heading"].map(number);
    return { i: number("i"), set: number("set"), other: number("other"), pose: pose.includes(null) ? null : pose };
  },
  write({ i, set, other, pose }) {
    const [x, y, heading] = pose.map((value) => value.toFixed(4));
    history.replaceState(null, "", `#${new URLSearchParams({ i, x, y, heading, set, ...(other === null ? {} : { other }) })}`);
  },
  address: () => location.href,
};

mount(document.getElementById("explorer"), ask, place);
