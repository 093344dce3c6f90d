// Places the note of the tour beside the button that it points at, with a ring round it.
const RING = 5, GAP = 26, EDGE = 12, TOP = 64, BOTTOM = 34;
const inSight = e => e.getClientRects().length > 0 && !e.matches('[data-disabled],:disabled');
const folded = () => document.querySelector('[data-dock-region=left] [data-dock-minimize-all]');
const target = note => {
  const { at, button } = note.dataset;
  const all = at ? [...document.querySelectorAll(at)]
    : button ? [...document.querySelectorAll('button')].filter(b => b.textContent.trim() === button) : [];
  /* The left panel is folded away in a narrow window: what lies in it is behind its handle. */
  return all.length || !button ? all.filter(inSight).at(-1) : folded();
};
/* The top nearest to `top` at which a note lies over no tools, legend or bar of the scene. */
const clear = (left, top, width, height) => {
  const boxes = [...document.querySelectorAll('.wv-glass')].map(at => at.getBoundingClientRect())
    .filter(box => box.width && left < box.right + EDGE && left + width > box.left - EDGE);
  const fits = y => y >= TOP && y + height <= innerHeight - BOTTOM - EDGE
    && boxes.every(box => y >= box.bottom + EDGE || y + height <= box.top - EDGE);
  const tops = [top, ...boxes.flatMap(box => [box.bottom + EDGE, box.top - EDGE - height])].filter(fits);
  return tops.sort((a, b) => Math.abs(a - top) - Math.abs(b - top))[0] ?? top;
};
/* Who works by key comes to what the note points at without a way there. */
let brought = '', byKey = false;
document.addEventListener('keyup', () => { byKey = true; }, true);
document.addEventListener('pointerdown', () => { byKey = false; }, true);
/* So does the card at the end, which gives the focus back. */
let ended = false, before = null;
const greet = () => {
  const card = document.querySelector('.wv-tour-end'), active = document.activeElement;
  if (ended === !!card) return;
  ended = !!card;
  if (card && byKey) {
    before = active;
    card.querySelector('.wv-tour-ways a')?.focus();
  } else if (!card && active === document.body) before?.focus();
};
const place = () => {
  greet();
  const note = document.querySelector('.wv-tour');
  if (!note) return;
  const ring = document.querySelector('.wv-tour-ring'), arrow = note.querySelector('.wv-tour-arrow');
  const aim = target(note), key = `${note.dataset.at}|${note.dataset.button}`;
  const press = note.querySelector('.wv-tour-press');
  if (press) press.style.visibility = aim ? 'visible' : 'hidden';
  if (aim && brought !== key) aim.scrollIntoView({ block: 'nearest' });
  if (aim && byKey && (brought !== key || document.activeElement === document.body)) aim.focus();
  brought = aim ? key : '';
  const { width, height } = note.getBoundingClientRect();
  ring.style.display = arrow.style.display = aim ? 'block' : 'none';
  let left = EDGE + 300, top = clear(EDGE + 300, innerHeight - BOTTOM - EDGE - height, width, height);
  if (aim) {
    const box = aim.getBoundingClientRect();
    Object.assign(ring.style, {
      left: `${box.left - RING}px`, top: `${box.top - RING}px`,
      width: `${box.width + 2 * RING}px`, height: `${box.height + 2 * RING}px`,
    });
    const middle = box.top + box.height / 2, below = box.top < TOP - 10;
    const toLeft = box.left - GAP - width > EDGE && box.left > innerWidth / 2;
    left = below ? box.left + box.width / 2 - width / 2 : toLeft ? box.left - GAP - width : box.right + GAP;
    top = below ? box.bottom + GAP : middle - height / 2;
    left = Math.min(Math.max(left, EDGE), innerWidth - width - EDGE);
    top = Math.min(Math.max(top, below ? 0 : TOP), innerHeight - BOTTOM - EDGE - height);
    top = clear(left, top, width, height);
    const side = below ? 'up' : toLeft ? 'right' : 'left';
    arrow.className = `wv-tour-arrow ${side}`;
    Object.assign(arrow.style, below
      ? { left: `${box.left + box.width / 2 - left}px`, top: '' }
      : { left: '', top: `${Math.min(Math.max(middle - top, 16), height - 16)}px` });
  }
  Object.assign(note.style, { left: `${left}px`, top: `${top}px`, visibility: 'visible' });
};
document.addEventListener('click', event => {
  if (event.target.closest?.('.wv-tour-press a')) target(document.querySelector('.wv-tour'))?.click();
});
setInterval(place, 100);
