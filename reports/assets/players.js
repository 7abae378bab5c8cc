// The players of all recordings; one is on screen.
import { inAddress, whenAddressChanges } from "./address.js";
import { make, nearest } from "./drawing.js";
import { choice } from "./figure.js";
import { startMomentList } from "./moment_list.js";
import { IN_ADDRESS, momentOfParts, outstandingMoment } from "./moments.js";
import { pageData } from "./page_data.js";
import { Player } from "./player.js";
import { whenShownChange } from "./shown_trackers.js";

// Fills the section of the moments: the player of the chosen recording; the still pictures are for pages without scripts.
export function startPlayers() {
  const section = document.getElementById("moments");
  if (!section) return;
  section.querySelector(".still").hidden = true;
  const names = pageData.players.map((recording) => [recording, recording]);
  const recordings = choice("Recording", names, names[0][0], (recording) => show(recording));
  recordings.hidden = names.length < 2;
  section.querySelector("h2").after(make("div", { class: "choices" }, recordings));
  const onward = names.length > 1 ? (kind) => show(recordingAfter(shown, kind)).arrive(kind) : null;
  const players = new Map(), place = make("div", {});
  section.append(place);
  let shown = null;
  const show = (recording) => {
    const isNew = !players.has(recording);
    if (isNew) players.set(recording, playerOf(recording, place, onward));
    const chosen = shown?.choice;
    shown?.leave();
    shown = players.get(recording);
    recordings.querySelector("select").value = recording;
    if (chosen) shown.choose(chosen);
    shown.element.hidden = false;
    fillLegend(shown.data);
    shown.arrange();
    if (isNew) shown.begin();
    return shown;
  };
  const open = (wanted) => show(wanted.recording).open(wanted);
  const follow = (parts) => {
    const wanted = momentOfParts(parts);
    if (!names.some(([name]) => name === wanted?.recording)) return false;
    open(wanted);
    return true;
  };
  new ResizeObserver(() => shown?.show()).observe(section);
  whenShownChange(() => shown.arrange());
  whenAddressChanges(IN_ADDRESS, follow);
  if (!follow(inAddress(IN_ADDRESS))) show(names[0][0]);
  startMomentList(section, momentsOf, (wanted) => open(wanted).keep());
}

// The legend of the recording on screen, with the words of templates/player.html.j2.
function fillLegend({ size, cell_m: cell, origin, moments }) {
  const metres = (length) => `${Number(length.toPrecision(6))} m`;
  document.getElementById("moments-window").textContent =
    `x to the right, y up; ${size} × ${size} cells of ${metres(cell)}, ${metres(size * cell)} across`;
  const isInside = (place, axis) => place >= origin[axis] && place <= origin[axis] + size * cell;
  const hasSensor = ({ sensors }) => sensors.some((point) => point.every(isInside));
  document.getElementById("moments-sensor").hidden = !moments.some(hasSensor);
}

function playerOf(recording, place, onward) {
  const element = make("div", { class: "player" });
  place.append(element);
  return new Player(element, momentsOf(recording), onward);
}

const readMoments = new Map();

// Each recording has its own element of moments, which is read on demand: the page opens without them.
export function momentsOf(recording) {
  if (!readMoments.has(recording)) {
    const element = document.getElementById(`moments-${pageData.players.indexOf(recording)}`);
    readMoments.set(recording, JSON.parse(element.textContent));
  }
  return readMoments.get(recording);
}

// The recording after the one of `player`, in the order of the values of their moments of this kind, with the same
// trackers at the same horizon; the first follows the last. Without another such recording it is its own.
function recordingAfter(player, kind) {
  const labels = player.shown.slice(0, kind.trackers).map((tracker) => player.data.trackers[tracker]);
  const { horizon } = player.choice;
  const found = pageData.players.flatMap((recording) => {
    const data = momentsOf(recording), trackers = labels.map((label) => data.trackers.indexOf(label));
    if (trackers.includes(-1)) return [];
    const best = outstandingMoment(data, kind, nearest(data.horizons_s, horizon), trackers);
    return best ? [{ recording, value: best.value }] : [];
  }).sort((a, b) => b.value - a.value);
  const own = found.findIndex(({ recording }) => recording === player.data.recording);
  return found.length ? found[(own + 1) % found.length].recording : player.data.recording;
}
