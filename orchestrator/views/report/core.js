// The numbers of the page, its colours, and what the plots and the replay share.

const data = revive(JSON.parse(document.getElementById("data").textContent));
const darkness = matchMedia("(prefers-color-scheme: dark)");
const hidden = new Set(); // keys that the legend has switched off
const find = (id) => document.getElementById(id);
const shows = (keys) => !keys.some((key) => hidden.has(key));
const tone = (colour) => colour[darkness.matches ? 1 : 0];
const isTouch = matchMedia("(pointer: coarse)").matches;

/** {f4: base64} becomes a Float32Array, everywhere within a value. */
function revive(value) {
  if (value === null || typeof value !== "object") return value;
  if (typeof value.f4 === "string") {
    const text = atob(value.f4), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    return new Float32Array(bytes.buffer);
  }
  for (const key of Object.keys(value)) value[key] = revive(value[key]);
  return value;
}

/** A colour of style.css by its name, as the theme has it now. */
function ink(name) {
  return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
}

/** The colour `name` at an opacity from 0 to 1. */
function faint(name, opacity) {
  const number = parseInt(name.startsWith("#") && name.length === 4 ? name.slice(1).replace(/./g, "$&$&") : name.slice(1), 16);
  return `rgba(${number >> 16}, ${(number >> 8) & 255}, ${number & 255}, ${opacity})`;
}

/** The last index whose time is at most t; times ascend. */
function indexAt(times, t) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** An element with attributes and children; text stays text. */
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

function paintChips() {
  for (const chip of document.querySelectorAll(".chip[data-colour]")) {
    const number = /^run(\d+)$/.exec(chip.dataset.colour);
    const colour = number ? data.runs[number[1]].colour : JSON.parse(chip.dataset.colour);
    chip.style.color = colour ? tone(colour) : ink("soft");
  }
}

paintChips();
darkness.addEventListener("change", paintChips);

const onSeek = []; // called with the time of the replay [s] whenever it changes
let seek = () => {}; // replay.js gives it
let redrawScene = () => {};
