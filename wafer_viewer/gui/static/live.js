/* Live at the bench: the pad that drives the stage, the word of a viewer, and the age of the picture.
   A held key repeats its word; the process of the rig stops the stage when no word comes. */
const MOVES = { 8: [0, 1, 0], 2: [0, -1, 0], 4: [-1, 0, 0], 6: [1, 0, 0], 9: [0, 0, 1], 3: [0, 0, -1] };
const OTHERS = { 5: 'focus', 7: 'smaller', 1: 'larger' };
const HOLD_MS = 250, WORD_MS = 150, WATCH_MS = 1000, STALE_MS = 1500;
const LATEST_ONLY = ['jog', 'watch'];
const say = (what, key) => window.wvReport(`live-${what}`, key, LATEST_ONLY.includes(what));
const pad = () => document.querySelector('.wv-pad:not([aria-disabled=true])');
const held = new Map();
let hold = 0, begins = 0, repeats = 0, fast = false;

const sum = () => [...held.values()].reduce((a, b) => a.map((v, k) => v + b[k]), [0, 0, 0]);
const word = () => say('jog', [hold, ...sum(), fast ? 1 : 0].join(','));
const jog = () => { begins = 0; hold = Date.now(); word(); repeats = setInterval(word, WORD_MS); };
const light = () => {
  for (const key of document.querySelectorAll('.wv-key')) key.classList.toggle('held', held.has(key.dataset.n));
};
const rest = () => {
  clearTimeout(begins);
  clearInterval(repeats);
  held.clear();
  light();
  if (repeats) say('jog', [hold, 0, 0, 0, 0].join(','));
  begins = repeats = 0;
};
const press = (n, shift) => {
  if (OTHERS[n]) { say(OTHERS[n], ''); return; }
  if (!MOVES[n] || held.has(n)) return;
  fast = shift;
  held.set(n, MOVES[n]);
  light();
  if (repeats) word();
  else if (!begins) begins = setTimeout(jog, HOLD_MS);
};
const release = n => {
  if (!held.has(n)) return;
  const step = sum();
  if (held.size === 1 && begins) { rest(); say('step', [...step, fast ? 1 : 0].join(',')); return; }
  held.delete(n);
  if (held.size === 0) rest();
  else { light(); if (repeats) word(); }
};

const digit = event => (/^(?:Digit|Numpad)([1-9])$/.exec(event.code) || [])[1];
const inPad = event => event.target.closest?.('.wv-pad');
document.addEventListener('keydown', event => {
  if (!inPad(event)) return;
  if (event.key === 'Escape') {
    rest();
    if (!event.shiftKey) { event.stopImmediatePropagation(); event.target.blur(); }
    return;
  }
  const n = digit(event);
  if (!n || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  if (!event.repeat && pad()) press(n, event.shiftKey);
}, true);
document.addEventListener('keyup', event => { const n = digit(event); if (n) release(n); }, true);
document.addEventListener('focusout', event => { if (inPad(event)) rest(); }, true);
document.addEventListener('pointerdown', event => {
  const key = event.target.closest?.('.wv-key');
  if (!key || event.button !== 0 || !pad()) return;
  event.preventDefault();
  pad().focus();
  press(key.dataset.n, event.shiftKey);
}, true);
document.addEventListener('pointerup', () => { for (const n of [...held.keys()]) release(n); }, true);
document.addEventListener('pointercancel', rest, true);
window.addEventListener('blur', rest);
window.addEventListener('pagehide', rest);
document.addEventListener('visibilitychange', () => { if (document.hidden) rest(); });

/* The view goes on while somebody sees it. */
let shown = '', since = 0;
setInterval(() => {
  if (document.querySelector('.wv-live') && !document.hidden) say('watch', String(Date.now()));
}, WATCH_MS);
setInterval(() => {
  const live = document.querySelector('.wv-live');
  if (!live) return;
  const src = document.querySelector('[data-floating-window]:has(.wv-live) img')?.src || '';
  if (src !== shown) { shown = src; since = performance.now(); }
  const still_s = (performance.now() - since) / 1000;
  live.classList.toggle('still', still_s * 1000 > STALE_MS);
  const note = live.querySelector('.wv-live-still');
  if (note) note.textContent = `The picture stands still for ${Math.floor(still_s)} s.`;
}, 250);
