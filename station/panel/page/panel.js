// The page of the panel as it is measured: views and records as they come, the screen of the oscilloscope drawn as
// one, the sign of life of who holds the control. Everything also works without this file, by loading again.

"use strict";

const at = (id) => document.getElementById(id);
const live = at("live");
let trace = null;

// ---- events of the measurement that is shown

function listen() {
  const source = new EventSource(`/events?job=${encodeURIComponent(live.dataset.job)}`);
  source.onopen = () => { at("off").hidden = true; };
  source.onerror = () => { at("off").hidden = false; };
  source.onmessage = (message) => take(JSON.parse(message.data));
}

function take(news) {
  if (news.view !== undefined) {
    const before = verdict();
    at("view").innerHTML = news.view;  // made and escaped by the panel
    if (verdict() && verdict() !== before) sound(verdict());
  }
  if (news.trace) { trace = news.trace; draw(); }
  if (news.alive !== undefined) {
    at("while-alive").hidden = !news.alive;
    at("when-ended").hidden = news.alive;
    at("cut-short").hidden = !news.cut_short;
    const scan = document.querySelector("#unit-form [name=unit]");
    if (scan && scan.disabled && !news.alive) { scan.disabled = false; scan.focus(); }
  }
  if (news.question !== undefined) {
    const was = at("answer").hidden;
    at("answer").hidden = !(news.question && news.alive);
    if (was && !at("answer").hidden) at("answer").querySelector("input").focus();
  }
  if (news.asked_by !== undefined && document.body.dataset.holds === "1") {
    at("asks").hidden = !news.asked_by;
    at("asks").textContent = document.body.dataset.asks.replace("{}", news.asked_by);
  }
}

function verdict() {
  const marked = at("view").querySelector("[data-verdict]");
  return marked ? marked.dataset.verdict : "";
}

function sound(word) {
  const wanted = at("sound");
  if (!wanted || !wanted.checked) return;
  const audio = new AudioContext();
  const tone = audio.createOscillator();
  tone.frequency.value = { PASS: 880, MARGINAL: 440 }[word] || 220;
  tone.connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.4);
}

// ---- the screen: 10 x 8 divisions, the record, its fit, and what the fit leaves

function draw() {
  const canvas = at("screen");
  canvas.closest(".screen-box").hidden = false;
  const pen = canvas.getContext("2d");
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name);
  const [width, height] = [canvas.width, canvas.height];
  pen.fillStyle = "#0b1016";
  pen.fillRect(0, 0, width, height);
  pen.strokeStyle = "#33404d";
  for (let part = 0; part <= 10; part++) line(pen, (part * width) / 10, 0, (part * width) / 10, height);
  for (let part = 0; part <= 8; part++) line(pen, 0, (part * height) / 8, width, (part * height) / 8);
  pen.strokeStyle = "#5b6b7a";
  line(pen, width / 2, 0, width / 2, height);
  line(pen, 0, height / 2, width, height / 2);
  const samples = trace.samples.filter((one) => one !== null);
  const low = Math.min(...samples), high = Math.max(...samples);
  const middle = (low + high) / 2, room = Math.max(high - low, 1e-12) / (0.72 * height);
  const up = (value) => height / 2 - (value - middle) / room;
  path(pen, trace.samples.map(up), width, colour("--trace"), 3);
  if (trace.fit) {
    path(pen, trace.fit.map(up), width, colour("--fit"), 2);
    const left = trace.samples.map((one, place) => one - trace.fit[place]);
    path(pen, left.map((one) => height * 0.93 - one / room), width, colour("--residual"), 1.5);
  }
  pen.fillStyle = "#c8d2db";
  pen.font = "22px sans-serif";
  const [each, unit] = trace.seconds < 10 ? [trace.seconds * 100, "ms"] : [trace.seconds / 10, "s"];
  pen.fillText(`${Number(each.toPrecision(3))} ${unit}/div   ${trace.key}`, 14, 28);
  document.querySelectorAll(".of-fit").forEach((one) => { one.hidden = !trace.fit; });
}

function line(pen, x, y, to_x, to_y) {
  pen.beginPath();
  pen.moveTo(x, y);
  pen.lineTo(to_x, to_y);
  pen.stroke();
}

function path(pen, heights, width, colour, thick) {
  pen.strokeStyle = colour;
  pen.lineWidth = thick;
  pen.beginPath();
  heights.forEach((y, place) => pen.lineTo((place * width) / (heights.length - 1), y));
  pen.stroke();
  pen.lineWidth = 1;
}

// ---- control, and small helps

if (document.body.dataset.holds === "1") {
  setInterval(() => fetch("/control/keep", { method: "POST" }).catch(() => {}), 10000);
}
const kind = document.querySelector("#kind select");
if (kind) kind.addEventListener("change", () => { location.href = kind.dataset.to + kind.value; });
if (live) listen();
