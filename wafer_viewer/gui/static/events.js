/* What a person does with the program's own elements, and what follows when one appears. The policy of the page allows
   no scripts in HTML, so an element says by data attributes what it is: `data-pick`, with its key in `data-k` or as the
   place of the click by `data-where`; `data-slide`; `data-drag`; `data-arrived`. */
const HELD_MS = 2000;
let picks = [], number = 0, sentTo;
/* viser sends only the last of several changes within 50 ms. The hidden field therefore holds all picks of the last two
   seconds, each with its number, so that none is lost; another field is that of another connection, where nothing
   of before is repeated. latestOnly: a value replaces the previous ones, for sliders. */
window.wvReport = (what, key, latestOnly = false) => {
  const field = document.querySelector('div:has(>.wv-picks)+div input'), now = performance.now();
  if (field !== sentTo) [picks, sentTo] = [[], field];
  picks = picks.filter(pick => now - pick[3] <= HELD_MS && !(latestOnly && pick[1] === what));
  picks.push([++number, what, key ?? '', now]);
  if (!field) return;
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(field, JSON.stringify(picks));
  field.dispatchEvent(new Event('input', { bubbles: true }));
};
window.wvClick = (at, more) => at.dispatchEvent(new MouseEvent('click', { bubbles: true, cancelable: true, ...more }));
const report = (event, ...pick) => { event.stopPropagation(); window.wvReport(...pick); };
const on = (type, attribute, handle) => document.addEventListener(type, event => {
  const at = event.target.closest?.(`[data-${attribute}]`);
  if (at) handle(event, at, at.dataset[attribute]);
}, true);
const across = (event, at) => (event.clientX - at.getBoundingClientRect().left) / at.clientWidth;
const within = share => Math.max(0, Math.min(1, share));

/* Places of a click as keys. */
const shares = (event, at) => [event.offsetX / at.clientWidth, event.offsetY / at.clientHeight];
const PLACES = {
  picture: (event, at) => shares(event, at).join(),
  held: (event, at) => (event.shiftKey ? 'to ' : event.ctrlKey || event.metaKey ? 'and ' : '') + at.dataset.k,
  corner: (event, at) => [at.dataset.at, ...(event.detail ? shares(event, at) : [0.5, 0.5])].join(';'),
  map: (event, at) => {
    /* Stage um, at any display scale: those at the upper left corner of the drawing, and its scale. */
    const [x, y, scale] = at.dataset.frame.split(',').map(Number);
    const p = new DOMPoint(event.clientX, event.clientY).matrixTransform(at.getScreenCTM().inverse());
    return `${(x + p.x / scale).toFixed(1)},${(y - p.y / scale).toFixed(1)}`;
  },
};
on('click', 'pick', (event, at, what) => {
  report(event, what, at.dataset.where ? PLACES[at.dataset.where](event, at) : at.dataset.k);
});
on('keydown', 'pick', (event, at) => {
  if (at.getAttribute('role') !== 'button' || (event.key !== 'Enter' && event.key !== ' ')) return;
  event.preventDefault();
  window.wvClick(at, { shiftKey: event.shiftKey, ctrlKey: event.ctrlKey, metaKey: event.metaKey });
});

/* Enter and leaving a field end a pause in typing; later than the value, which viser sends once in 50 ms. */
let typedIn;
const entered = at => {
  if (at !== typedIn) return;
  typedIn = undefined;
  setTimeout(window.wvReport, 70, 'entered');
};
const TYPED = ':is(.mantine-NumberInput-input, .mantine-TextInput-input):not([aria-hidden=true])';
document.addEventListener('input', event => { if (event.target.matches(TYPED)) typedIn = event.target; }, true);
document.addEventListener('focusout', event => entered(event.target), true);
document.addEventListener('keydown', event => { if (event.key === 'Enter') entered(event.target); }, true);

/* A link to a saved view names it after the # of the address, which viser's client drops when it starts; so a reload
   stays where one is. */
on('click', 'link', (_, at) => history.replaceState(null, '', `#${at.dataset.link}`));
const follow = link => {
  const [, number, dataset] = /^#view=(\d+)&of=(.+)$/.exec(link) ?? [];
  if (!number) return;
  if (document.querySelector('.wv-title')) window.wvReport('view-linked', `${number}:${decodeURIComponent(dataset)}`);
  else setTimeout(follow, 300, link);
};
addEventListener('hashchange', () => follow(location.hash));
follow(location.hash);

/* Range inputs, while they move and when they are let go. */
const moved = at => `${at.name}:${at.value}:${at.dataset.by || 'key'}:`;
const SLIDES = {
  input: { cursor: moved, 'why-frame': at => at.value },
  change: { cursor: at => `${moved(at)}end`, 'live-range': at => `${at.name}:${at.value}` },
};
for (const type of Object.keys(SLIDES)) {
  on(type, 'slide', (event, at, what) => {
    const key = SLIDES[type][what];
    if (key) report(event, what, key(at), true);
    if (type === 'change') delete at.dataset.by;
  });
}
on('pointerdown', 'slide', (event, at) => { at.dataset.by = 'hand'; });

/* Drags over the curves and over the histogram. Where they began is kept here, so that a drag goes on over a drawing
   that is replaced meanwhile. */
let from, brush;
const DRAGS = {
  plot: {
    pointerdown(event, at) {
      if (event.button !== 0) return;
      at.setPointerCapture(event.pointerId);
      from = across(event, at);
    },
    pointermove(event, at) {
      const style = at.firstElementChild.style, to = across(event, at);
      if (!(event.buttons & 1)) { from = undefined; style.display = 'none'; }
      if (from === undefined) return;
      const left = `${100 * Math.max(0, Math.min(from, to))}%`, right = `${100 * Math.max(0, 1 - Math.max(from, to))}%`;
      Object.assign(style, { display: 'block', left, right });
    },
    pointerup(event, at) {
      if (from === undefined) return;
      at.firstElementChild.style.display = 'none';
      report(event, 'plot', `${from}:${across(event, at)}`);
      from = undefined;
    },
    dblclick: event => report(event, 'plot', 'whole'),
  },
  histogram: {
    pointerdown(event, at) {
      if (event.button !== 0) return;
      event.stopPropagation();
      at.setPointerCapture(event.pointerId);
      const x = within(across(event, at));
      const near = [...at.querySelectorAll('b')]
        .map(grip => [Math.abs(parseFloat(grip.style.left) / 100 - x), grip.dataset.grip])
        .filter(([distance]) => distance < at.dataset.gripPx / at.clientWidth)
        .sort((a, b) => a[0] - b[0]);
      brush = [near.length ? near[0][1] : 'brush', x];
    },
    pointermove(event, at) {
      if (!(event.buttons & 1)) brush = undefined;
      if (!brush) return;
      const [act, first] = brush, x = within(across(event, at)), style = at.firstElementChild.style;
      if (act === 'brush') {
        const left = `${100 * Math.min(first, x)}%`, width = `${100 * Math.abs(first - x)}%`;
        Object.assign(style, { display: 'block', left, width });
      } else at.querySelector(`b[data-grip=${act}]`).style.left = `${100 * x}%`;
    },
    pointerup(event, at) {
      if (brush) report(event, 'histogram', `${brush.join(':')}:${within(across(event, at))}`);
      brush = undefined;
    },
  },
};
for (const type of ['pointerdown', 'pointermove', 'pointerup', 'dblclick']) {
  on(type, 'drag', (event, at, what) => DRAGS[what][type]?.(event, at));
}

/* What takes the focus when it appears: the slider of a cursor that was made again, the field of a barcode reader (a
   keyboard), a list of files that had it. */
const ARRIVED = {
  cursor: at => document.querySelector(`.wv-slide[name="${at.dataset.k}"]`)?.focus(),
  wafer: () => setTimeout(() => document.querySelector('div:has(>.wv-scan)+div input')?.focus(), 300),
  files: at => {
    const list = at.closest('.wv-files'), active = document.activeElement;
    if (list && (!active?.matches('input') || active.closest('.wv-files'))) list.focus({ preventScroll: true });
  },
};
new MutationObserver(records => {
  for (const node of records.flatMap(record => [...record.addedNodes])) {
    if (node.nodeType !== Node.ELEMENT_NODE) continue;
    for (const at of [node, ...node.querySelectorAll('[data-arrived]')]) {
      if (at.dataset?.arrived) setTimeout(ARRIVED[at.dataset.arrived], 0, at);
    }
  }
}).observe(document.body, { childList: true, subtree: true });

/* The key of a button's command, as its title. */
document.addEventListener('mouseover', event => {
  const button = event.target.closest?.('button');
  if (!button || button.title) return;
  const titles = JSON.parse(document.querySelector('[data-titles]')?.dataset.titles || '{}');
  const title = titles[button.textContent.trim()];
  if (title) button.title = title;
});
