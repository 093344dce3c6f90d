/* One look over the page as it stands: what cannot be hit, is cut, covered or overlaps, has no name, or is too pale.
   Installs window.wvAudit once a page. look(other) waits until the layout is at rest; with `other`, the colours of the
   other theme, the page is then turned to them, its contrasts are judged again, and it stays so. Returns [findings,
   findings when turned]; a finding is a sentence that names the element in words of the page. */
window.wvAudit || (() => {
  const CONTROLS = 'button, input, select, textarea, a[href], summary, [role=button], [role=slider], [role=tab]';
  const DIALOG = '.mantine-Modal-content, .mantine-Spotlight-content, .wv-tour-end';
  const ASIDE = '[aria-hidden=true], [inert], .mantine-Notification-root, .u-over';
  const SCROLLER = '.mantine-ScrollArea-viewport, .wv-sheet, .mantine-Modal-content, .mantine-ScrollArea-root';
  const RESTING_FRAMES = 2, REST_MS = 6000;
  const TAG = /<\/[a-z]+>|<[a-z]+ [a-z-]+=|&(?:[a-z]+|#\d+);/i;
  const CRAMPED_PX = 300 + 404 + 440;  // browser.py: below it the left panel is folded away

  const all = selector => [...document.querySelectorAll(selector)];
  const boxOf = element => element.getBoundingClientRect();
  const words = text => String(text?.baseVal ?? text ?? '').replace(/\s+/g, ' ').trim().slice(0, 48);
  const nameOf = element => {
    const by = (element.getAttribute('aria-labelledby') ?? '').split(' ').map(id => document.getElementById(id)?.textContent);
    const given = [element.getAttribute('aria-label'), by.join(' '), ...[...(element.labels ?? [])].map(l => l.textContent)];
    if (!element.matches('input, select, textarea')) given.push(element.textContent);
    return words([...given, element.title].find(text => words(text)));
  };
  const rowLabel = e => words(e.closest('.mantine-Flex-root')?.querySelector('label')?.textContent);
  const called = e => `${e.tagName.toLowerCase()}${e.type ? `[${e.type}]` : ''} "${nameOf(e) || rowLabel(e) || words(e.className)}"`;

  /* --- the layout at rest: panels have followed the scene, and nothing has moved for some frames */

  const scene = () => document.querySelector('[data-dock-root] > div:first-child');
  const unsettled = () => {
    if (document.querySelector('.wv-bar-over.lost.on')) return '';  // nobody is there to lay it out
    const left = document.querySelector('[data-dock-region=left]');
    if (left && !!left.querySelector('[data-dock-minimize-all]') !== innerWidth < CRAMPED_PX) return 'the left panel';
    const wide = boxOf(scene()).width;
    for (const bottom of all('[data-floating-window]:has(.wv-bottom)'))
      if (boxOf(bottom).width && Math.abs(boxOf(bottom).width - wide) > 2) return 'the panel below the scene';
    const note = document.querySelector('.wv-tour');
    return note && getComputedStyle(note).visibility !== 'visible' ? 'the note of the tour' : '';
  };
  const frame = () => new Promise(done => requestAnimationFrame(done));
  const LARGE = '[data-floating-window], [data-dock-region], [data-dock-root] > div, .wv-tour, .wv-title, .wv-head, .mantine-Flex-root';
  const rest = async () => {
    const end = performance.now() + REST_MS;
    for (let before = '', still = 0; still < RESTING_FRAMES || unsettled();) {
      if (performance.now() > end) return unsettled() || 'the page';
      await frame();
      const now = all(LARGE).map(e => { const r = boxOf(e); return `${r.x},${r.y},${r.width},${r.height}`; }).join() + document.body.textContent.length;
      still = now === before ? still + 1 : 0;
      before = now;
    }
    return '';
  };

  /* --- facts of an element, worked out once a look */

  const rgba = text => {
    const n = (text.match(/[\d.]+/g) ?? [0, 0, 0, 0]).map(Number);
    const scale = text.startsWith('color(') ? 255 : 1;
    return [n[0] * scale, n[1] * scale, n[2] * scale, n[3] ?? 1];
  };
  const over = (top, under) => top.slice(0, 3).map((c, i) => c * top[3] + under[i] * (1 - top[3]));
  const light = c => {
    const [r, g, b] = c.map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const contrast = (ink, ground) => {
    const [a, b] = [light(over(ink, ground)), light(ground)].sort((p, q) => q - p);
    return (a + 0.05) / (b + 0.05);
  };

  let facts = new Map();
  const factsOf = element => {
    if (!element) return { opacity: 1, ground: null, drawn: false, seen: true, hides: [] };
    let now = facts.get(element);
    if (now) return now;
    const above = factsOf(element.parentElement), s = getComputedStyle(element);
    const back = rgba(s.backgroundColor), opacity = above.opacity * Number(s.opacity);
    const hides = s.position === 'fixed' ? [] : above.hides;
    const clips = /hidden|clip/.test(s.overflowX) || /hidden|clip/.test(s.overflowY);
    now = {
      s, opacity, above,
      seen: above.seen && s.display !== 'none' && opacity > 0,
      ground: back[3] === 1 ? back.slice(0, 3) : above.ground && over(back, above.ground),
      drawn: back[3] < 1 && (/url|gradient/.test(s.backgroundImage) || above.drawn),
      hides: clips && !element.matches('html, body, #root, [data-dock-root]') ? [...hides, element] : hides,
    };
    if (element === document.body) now.ground = rgba(getComputedStyle(document.querySelector('#root')).backgroundColor).slice(0, 3);
    facts.set(element, now);
    return now;
  };
  const shown = element => {
    const { seen, s } = factsOf(element);
    if (!seen || s.visibility !== 'visible') return false;
    const r = boxOf(element);
    return r.width > 1 && r.height > 1;
  };
  let modal = null;
  const inPlay = element => (!modal || modal.contains(element)) && !element.closest(ASIDE) && shown(element) && boxOf(element).right >= 0;
  const off = element => element.matches(':disabled, [aria-disabled=true], [data-disabled], .off') || factsOf(element).s.pointerEvents === 'none';
  const sticks = element => {
    for (let at = element; at; at = at.parentElement) if (factsOf(at).s.position === 'sticky') return true;
    return false;
  };

  /* --- controls can be hit in their middle, where they lie or where their panel scrolls them to */

  const isAt = (element, x, y) => {
    const hit = document.elementFromPoint(x, y);
    if (!hit) return 'nothing: outside of the window';
    if (hit.closest('.wv-tour') && !element.closest('.wv-tour')) return '';  // what it may not cover: see tour
    if (hit.matches('.wv-dot') && element.matches('.wv-dot')) return '';  // points of a chart may lie on each other
    const same = element.contains(hit) || hit.contains(element) && hit.closest('label, button, [role=button]')?.contains(element) ||
      [...(element.labels ?? [])].some(label => label.contains(hit)) ||
      element.parentElement.contains(hit) && element.matches('input, [role=slider]');
    return same ? '' : called(hit);
  };
  const inSightOf = element => {  // its box without what its panel has scrolled away
    let { left, top, right, bottom } = boxOf(element);
    for (let view = element.closest(SCROLLER); view; view = view.parentElement.closest(SCROLLER)) {
      const r = boxOf(view);
      [left, top, right, bottom] = [Math.max(left, r.left), Math.max(top, r.top), Math.min(right, r.right), Math.min(bottom, r.bottom)];
    }
    return { left, top, right, bottom };
  };
  const hits = found => {
    const inSight = [];
    for (const control of all(CONTROLS)) {
      if (!inPlay(control) || off(control) && words(control.textContent) !== 'Stop' || control.closest('svg') || control.type === 'hidden') continue;
      const middle = () => { const r = boxOf(control); return [r.left + r.width / 2, r.top + r.height / 2]; };
      let other = isAt(control, ...middle());
      if (!other && !control.closest('.wv-tour')) inSight.push(control);
      else if (control.closest(SCROLLER)) {
        const view = control.closest(SCROLLER), at = view.scrollTop;
        control.scrollIntoView({ block: 'center' });
        other = isAt(control, ...middle());
        view.scrollTop = at;
      }
      if (other) found.push(`hit: the middle of ${called(control)} is ${other}`);
      const r = boxOf(control);
      if (r.left < -1 || r.right > innerWidth + 1) found.push(`outside: ${called(control)} leaves the window`);
    }
    const boxes = inSight.map(inSightOf);
    for (let i = 0; i < inSight.length; i++)
      for (let k = i + 1; k < inSight.length; k++) {
        const [p, q] = [boxes[i], boxes[k]];
        const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left), high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
        if (wide <= 3 || high <= 3) continue;
        const [a, b] = [inSight[i], inSight[k]];
        if (a.contains(b) || b.contains(a) || a.parentElement === b.parentElement && a.matches('input, [role=slider]')) continue;
        if (!sticks(a) && !sticks(b) && !a.matches('[type=range]') && !b.matches('[type=range]')) found.push(`overlap: ${called(a)} and ${called(b)}`);
      }
  };

  /* --- the note of the tour leaves free what it points at, Stop and the scale bar */

  const tour = found => {
    const note = all('.wv-tour').find(shown);
    if (!note) return;
    const n = boxOf(note), ring = document.querySelector('.wv-tour-ring');
    const meets = r => Math.min(n.right, r.right) - Math.max(n.left, r.left) > 1 && Math.min(n.bottom, r.bottom) - Math.max(n.top, r.top) > 1;
    const aimed = note.dataset.button || note.dataset.at;
    if (aimed && !shown(ring)) found.push(`tour: nothing is shown that "${aimed}" names`);
    if (shown(ring) && meets(boxOf(ring))) found.push(`tour: the note covers what it points at, "${aimed}"`);
    for (const [name, other] of [['Stop', all('button').find(b => words(b.textContent) === 'Stop')], ['the scale bar', document.querySelector('.wv-scale')]])
      if (other && shown(other) && meets(boxOf(other))) found.push(`tour: the note covers ${name}`);
  };

  /* --- inputs have names of their own, for those who do not see the label beside them; their contents are whole */

  const inputs = found => {
    for (const input of all('input, select, textarea, [role=slider], button')) {
      if (input.type === 'hidden' || !inPlay(input)) continue;
      if (!nameOf(input)) found.push(`name: ${called(input)} has none`);
      if (/^(text|number)$/.test(input.type) && input.scrollWidth > input.clientWidth + 1)
        found.push(`cut: what stands in ${called(input)}: ${words(input.value)}`);
    }
  };

  /* --- text is whole, unless it ends in an ellipsis and a tip has the rest; nothing lies over it */

  const texts = () => {
    const found = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), range = document.createRange();
    while (walker.nextNode()) {
      const node = walker.currentNode, element = node.parentElement;
      if (!words(node.data) || element.closest('svg, style, script, .wv-bar-over:not(.on)') || !inPlay(element)) continue;
      if (factsOf(element).s.clipPath !== 'none') continue;
      range.selectNodeContents(node);
      const text = range.getBoundingClientRect();
      if (text.width >= 2) found.push({ element, text, said: words(node.data) });
    }
    return found;
  };
  const whole = (found, { element, text, said }) => {
    const { hides } = factsOf(element);
    for (const by of hides) {
      const r = boxOf(by), s = factsOf(by).s;
      if (r.width === 0) continue;
      const wide = /hidden|clip/.test(s.overflowX) && (text.right > r.right + 2 || text.left < r.left - 2);
      if (!wide) continue;
      let told = false, ellipsis = false;
      for (let at = element; at && by.contains(at); at = at.parentElement) {
        const its = factsOf(at).s;
        told ||= !!at.title;
        ellipsis ||= its.textOverflow === 'ellipsis' && its.overflowX !== 'visible';
      }
      if (!(ellipsis && told)) { found.push(`cut: "${said}" by ${words(by.className) || by.tagName}`); break; }
    }
    if (text.right > innerWidth + 1) found.push(`cut: "${said}" by the window`);
  };

  /* --- text stands off its ground */

  const pale = seen => {
    const lines = new Map(), known = new Map();
    for (const { element, said } of seen) {
      const { s, opacity, ground, drawn } = factsOf(element);
      if (drawn) continue;
      const ink = rgba(s.webkitTextFillColor || s.color), large = parseFloat(s.fontSize) >= 24 || parseFloat(s.fontSize) >= 18.66 && Number(s.fontWeight) >= 700;
      ink[3] *= opacity;
      const key = `${ink}|${ground}`;
      if (!known.has(key)) known.set(key, contrast(ink, ground));
      const ratio = known.get(key);
      if (ratio < (large ? 3 : 4.5) - 0.005) lines.set(element.className, `pale: "${said}" ${ratio.toFixed(2)} : 1, ${words(element.className)}`);
    }
    return [...lines.values()];
  };

  /* --- the other theme: its colours as style.py and viser write them, on the page that is there */

  const theme = () => {
    const own = document.documentElement.dataset.mantineColorScheme;
    const palette = all('style').map(s => s.textContent).find(text => text.startsWith(':root,[data-mantine-color-scheme]{--panel'));
    return { name: own, palette: palette.slice(0, palette.indexOf('}') + 1), mantine: document.querySelector('style[data-mantine-styles]')?.textContent ?? '' };
  };
  let laid = null;
  const turn = other => {
    laid?.remove();
    laid = document.createElement('style');
    laid.textContent = other.mantine + other.palette;
    document.body.append(laid);
    document.documentElement.dataset.mantineColorScheme = other.name;
  };
  const turnBack = () => {
    laid?.remove();
    document.documentElement.dataset.mantineColorScheme = 'light';
  };
  document.head.insertAdjacentHTML('beforeend', '<style>*, ::before, ::after { transition: none !important; animation: none !important; }</style>');
  const begin = () => { facts = new Map(); modal = all(DIALOG).filter(e => boxOf(e).width).pop() ?? null; };

  /* The page stays turned: the next look, with the colours that were there at first, turns it back. */
  const look = async other => {
    const found = [], moves = await rest();
    begin();
    if (moves) found.push(`layout: ${moves} does not come to rest`);
    hits(found);
    tour(found);
    inputs(found);
    const seen = texts();
    for (const text of seen) whole(found, text);
    for (const { said } of seen) if (TAG.test(said)) found.push(`markup shown as text: "${said}"`);
    found.push(...pale(seen));
    if (!other) return [[...new Set(found)], []];
    turn(other);
    begin();
    return [[...new Set(found)], pale(texts())];
  };

  /* Every text with its colour and ground: the same whether the page was turned by itself or here. What lies around it
     is part of its name, as two places may say the same in different colours, and one of them come in later. */
  const colours = () => {
    begin();
    return Object.fromEntries(texts().map(({ element, said }) => {
      const { s, ground } = factsOf(element);
      const around = element.parentElement.closest('[class]');
      return [`${said} · ${words(element.className)} in ${words(around?.getAttribute('class') ?? '')}`, `${s.color} on ${ground?.map(Math.round)}`];
    }));
  };
  const coloursTurned = other => {
    const own = theme();
    turn(other);
    const found = colours();
    turn(own);
    return found;
  };
  window.wvAudit = { look, rest, theme, turn, turnBack, colours, coloursTurned };
})();
