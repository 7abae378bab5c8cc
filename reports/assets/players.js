// The players of all recordings, of which one is on screen.
import { choice } from "./choices.js";
import { make } from "./elements.js";
import { momentOfLink } from "./moment_link.js";
import { pageData } from "./page_data.js";
import { Player } from "./player.js";
import { whenShownChange } from "./shown_trackers.js";

// Fills the section of the moments: the player of the chosen recording; the still pictures are for pages without scripts.
export function startPlayers() {
  const section = document.getElementById("moments");
  if (!section) return;
  section.querySelector(".still").hidden = true;
  const players = new Map();
  let shown = null;
  const show = (recording) => {
    if (!players.has(recording)) players.set(recording, playerOf(recording, section));
    const labels = shown?.labels;
    shown?.leave();
    shown = players.get(recording);
    if (labels) shown.choose(labels);
    shown.element.hidden = false;
    shown.arrange();
    return shown;
  };
  const names = pageData.players.map((recording) => [recording, recording]);
  const recordings = choice("Recording", names, names[0][0], show);
  recordings.hidden = names.length < 2;
  section.querySelector("h2").after(make("div", { class: "choices" }, recordings));
  const follow = () => {
    const wanted = momentOfLink(location.hash);
    if (!names.some(([name]) => name === wanted?.recording)) return false;
    recordings.querySelector("select").value = wanted.recording;
    show(wanted.recording).open(wanted);
    return true;
  };
  new ResizeObserver(() => shown?.show()).observe(section);
  whenShownChange(() => shown.arrange());
  window.addEventListener("hashchange", follow);
  if (!follow()) show(names[0][0]);
}

// The moments of each recording are an element of their own, read when it is shown: the page opens without them.
function playerOf(recording, section) {
  const element = make("div", { class: "player" });
  section.append(element);
  const moments = document.getElementById(`moments-${pageData.players.indexOf(recording)}`);
  return new Player(element, JSON.parse(moments.textContent));
}
