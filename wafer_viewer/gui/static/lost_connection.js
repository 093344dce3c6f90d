/* The bar over the header while the program cannot be reached, and for a moment afterwards; after a restart below it, so
   that the steps stay in reach. It works without the program: what it says was put into the page while there was contact. */
/* viser tries to connect again only in the window that has the focus; an instrument's page often has not. */
document.hasFocus = () => true;

const TICK_MS = 250, SILENT_MS = 10000, BACK_MS = 8000;
const CLOSED = '[data-dock-unmergeable-header] :is(.mantine-Loader-root, .tabler-icon-player-pause)';
const icon = paths => `<svg width="26" height="26" viewBox="0 0 24 24" fill="none" stroke="currentColor"
  stroke-width="2" stroke-linecap="round" stroke-linejoin="round" aria-hidden="true">${paths}</svg>`;
const PLUG = '<path d="M7 12l5 5-1.5 1.5a3.5 3.5 0 0 1-5-5zM17 12l-5-5 1.5-1.5a3.5 3.5 0 0 1 5 5zM3 21l2.5-2.5"/>' +
  '<path d="M18.5 5.5l2.5-2.5M10 11l-2 2M13 14l-2 2"/>';
const APART = `${PLUG}<path d="M16 16l4 4M20 16l-4 4"/>`;
const HAND = '<path d="M8 13V5.5a1.5 1.5 0 0 1 3 0V12M11 5.5v-2a1.5 1.5 0 1 1 3 0V12M14 5.5a1.5 1.5' +
  ' 0 0 1 3 0V12M17 7.5a1.5 1.5 0 0 1 3 0V16a6 6 0 0 1-6 6h-2a6 6 0 0 1-5-2.7L4 14.7a1.5 1.5 0 0 1 2.5-1.6L8 15"/>';
const ANEW = '<path d="M20 11A8 8 0 0 0 6 6.3L4 8M4 4v4h4M4 13a8 8 0 0 0 14 4.7L20 16M20 20v-4h-4M12 9v3M12 15h.01"/>';

document.head.insertAdjacentHTML('beforeend', `<style>
  .wv-bar-over { position: fixed; inset: 0 0 auto 0; z-index: 10000; box-sizing: border-box; min-height: 56px;
    padding: 7px 24px; display: none; align-items: center; gap: 16px; font-size: 13.5px; line-height: 1.35;
    font-family: Inter, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; font-variant-numeric: tabular-nums; }
  .wv-bar-over.on { display: flex; }
  .wv-bar-over svg { flex: none; }
  .wv-bar-over > div:first-of-type { flex: 1; min-width: 0; }
  .wv-bar-over b { display: block; font-size: 17px; font-weight: 650; }
  .wv-bar-over.lost { background: #B42318; color: #FFFFFF; }
  .wv-bar-over.back { right: var(--stop-right, 404px); }
  .wv-bar-over.anew { top: 56px; }
  body.wv-anew #root { padding-top: 112px; }
  .wv-bar-over.back { background: #18794E; color: #FFFFFF; }
  .wv-bar-over.anew { background: #FFF1D6; color: #5E3900; }
  .wv-bar-over .box { flex: none; display: flex; gap: 10px; align-items: center; padding: 4px 12px; white-space: pre-line;
    border: 2px solid #FFFFFF; border-radius: 8px; font-weight: 650; }
  .wv-bar-over button { flex: none; font: inherit; font-weight: 650; padding: 7px 16px; border-radius: 6px; cursor: pointer;
    border: 1.5px solid currentColor; background: #FFFFFF; color: #5E3900; }
  body.wv-no-contact :is([data-dock-region], [data-floating-window], .wv-strip) { opacity: .5; }
  body.wv-no-contact :is([data-dock-region], [data-floating-window]) :is([data-dock-region], .wv-strip) { opacity: 1; }
</style>`);
const bar = document.createElement('div');
document.body.append(bar);

const safe = text => { const at = document.createElement('i'); at.textContent = text ?? ''; return at.innerHTML; };
const told = () => document.querySelector('.wv-contact');
const clock = at => new Date(at).toTimeString().slice(0, 8);
const span = ms => {
  const s = Math.floor(ms / 1000);
  return `${Math.floor(s / 60)}:${String(s % 60).padStart(2, '0')}`;
};
const show = (look, html) => {
  bar.className = `wv-bar-over ${look} ${look && 'on'}`;
  bar.setAttribute('role', look === 'lost' ? 'alert' : 'status');
  bar.innerHTML = html;
  document.body.classList.toggle('wv-anew', look === 'anew');
};
/* Pale, and out of reach of pointer and keyboard: also what viser laid beside its root. */
const reachable = yes => {
  document.body.classList.toggle('wv-no-contact', !yes);
  for (const part of document.body.children) if (part !== bar) part.inert = !yes;
};

const startedAnew = now => {
  until = Infinity;
  show('anew', `${icon(ANEW)}<div><b>The instrument was restarted at ${safe(now.since)}</b>${safe(now.anew)}</div>
    <button type="button">${safe(now.look)}</button>`);
};

let last = null, wasClosed = false, heardAt = 0, lostAt = 0, beat = null, silent = 0, tickAt = Date.now(), until = 0;

const lose = () => {
  lostAt = Date.now() - silent;
  until = 0;
  show('lost', `${icon(APART)}<div><b>No contact with the instrument<span aria-hidden="true"> for <i style="font-style:
    normal" data-for></i></span></b>Last word at ${clock(heardAt)}: ${safe(last.state)}. What stands below is of that
    time. <span aria-hidden="true" data-try></span></div><div class="box">${icon(HAND)}<span>${safe(last.box)}</span></div>`);
};
const count = () => {
  const gone = Date.now() - lostAt;
  bar.querySelector('[data-for]').textContent = span(gone);
  bar.querySelector('[data-try]').textContent = `Trying again every second, try ${Math.floor(gone / 1000) + 1}.`;
  reachable(false);
};
const regain = now => {
  const gone = span(Date.now() - lostAt);
  lostAt = 0;
  reachable(true);
  if (now.program === last.program) {
    until = Date.now() + BACK_MS;
    show('back', `${icon(PLUG)}<div><b>Contact again after ${gone}</b>${safe(now.back)}</div><span>${clock(Date.now())}</span>`);
  } else {
    startedAnew(now);
  }
};
bar.addEventListener('click', event => {
  if (lostAt) return;
  if (event.target.closest('button')) document.querySelector('.wv-contact [data-pick]')?.click();
  if (bar.classList.contains('back') || event.target.closest('button')) show('', '');
});

/* Time in which this page itself was busy, or hidden, or drew nothing is not the program's silence. */
let drawn = false;
const listen = element => {
  const now = Date.now(), heard = element?.dataset.beat;
  if (heard !== beat || document.hidden || !element) silent = 0;
  else if (drawn) silent += Math.min(now - tickAt, 2 * TICK_MS);
  drawn = false;
  requestAnimationFrame(() => { drawn = true; });
  if (element && heard !== beat) heardAt = now;
  beat = heard;
  tickAt = now;
};
setInterval(() => {
  const element = told();
  listen(element);
  const closed = !!document.querySelector(CLOSED), lost = closed || silent > SILENT_MS;
  wasClosed = closed || (wasClosed && !!lostAt);
  /* A closed connection is back only with a page made anew; what it left behind may still be there. */
  if (lostAt && !lost && element && !(wasClosed && element.dataset.page === last.page)) regain(element.dataset);
  else if (!lostAt && lost && last) lose();
  if (lostAt) count();
  else if (element) {
    /* A program that was just started still reads what it had kept: the bar follows it. */
    const { anew, look } = element.dataset, changed = last && (anew !== last.anew || look !== last.look);
    last = { ...element.dataset };
    if (changed && bar.classList.contains('anew')) startedAnew(last);
  }
  if (until && Date.now() > until) { until = 0; show('', ''); }
}, TICK_MS);
