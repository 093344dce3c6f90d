/* One look over the page as it stands: what cannot be hit, is cut, overlaps, has no name, or is too pale.
   Returns sentences; each names the element in words of the page. */
({ widthPx }) => {
  const found = [];
  const all = selector => [...document.querySelectorAll(selector)];
  const box = element => element.getBoundingClientRect();
  const words = text => String(text?.baseVal ?? text ?? '').replace(/\s+/g, ' ').trim().slice(0, 48);
  const rowLabel = e => words(e.closest('.mantine-Flex-root')?.querySelector('label')?.textContent);
  const nameOf = element => {
    const by = (element.getAttribute('aria-labelledby') ?? '').split(' ').map(id => document.getElementById(id)?.textContent);
    const given = [element.getAttribute('aria-label'), by.join(' '), ...[...(element.labels ?? [])].map(l => l.textContent)];
    if (!element.matches('input, select, textarea')) given.push(element.textContent);
    return words([...given, element.title].find(text => words(text)));
  };
  const called = e => `${e.tagName.toLowerCase()}${e.type ? `[${e.type}]` : ''} "${nameOf(e) || rowLabel(e) || words(e.className)}"`;
  const shown = element => {
    const r = box(element);
    return r.width > 1 && r.height > 1 && element.checkVisibility({ opacityProperty: true, visibilityProperty: true });
  };
  const aside = element => !!element.closest('[aria-hidden=true], .mantine-Notification-root, .u-over') || box(element).right < 0;
  const modal = all('.mantine-Modal-content, .mantine-Spotlight-content').pop();
  const inPlay = element => (!modal || modal.contains(element)) && shown(element) && !aside(element);
  const off = element => element.matches(':disabled, [aria-disabled=true], [data-disabled], .off') ||
    getComputedStyle(element).pointerEvents === 'none';
  const scroller = element => element.closest('.mantine-ScrollArea-viewport, .wv-sheet, .mantine-Modal-content, .mantine-ScrollArea-root');
  const isAt = (element, x, y) => {
    const hit = document.elementFromPoint(x, y);
    if (!hit) return 'nothing: outside of the window';
    const same = element.contains(hit) || hit.contains(element) && hit.closest('label, button, [role=button]')?.contains(element) ||
      [...(element.labels ?? [])].some(label => label.contains(hit)) ||
      element.parentElement.contains(hit) && element.matches('input, [role=slider]');
    return same ? '' : called(hit);
  };

  /* Controls can be hit in their middle, where they lie or where their panel scrolls them to. */
  const CONTROLS = 'button, input, select, textarea, a[href], summary, [role=button], [role=slider], [role=tab]';
  const controls = all(CONTROLS).filter(e => inPlay(e) && !off(e) && !e.closest('svg') && e.type !== 'hidden');
  const sticks = element => {
    for (let at = element; at; at = at.parentElement) if (getComputedStyle(at).position === 'sticky') return true;
    return false;
  };
  const inSight = [];
  for (const control of controls) {
    const middle = () => { const r = box(control); return [r.left + r.width / 2, r.top + r.height / 2]; };
    let other = isAt(control, ...middle());
    if (!other) inSight.push(control);
    else if (scroller(control)) {
      const view = scroller(control), at = view.scrollTop;
      control.scrollIntoView({ block: 'center' });
      other = isAt(control, ...middle());
      view.scrollTop = at;
    }
    if (other) found.push(`hit: the middle of ${called(control)} is ${other}`);
    const r = box(control);
    if (r.left < -1 || r.right > innerWidth + 1) found.push(`outside: ${called(control)} leaves the window`);
  }
  for (let i = 0; i < inSight.length; i++)
    for (let k = i + 1; k < inSight.length; k++) {
      const [a, b] = [inSight[i], inSight[k]];
      if (a.contains(b) || b.contains(a) || a.parentElement === b.parentElement && a.matches('input, [role=slider]')) continue;
      const [p, q] = [box(a), box(b)];
      const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left), high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
      if (wide > 3 && high > 3 && !sticks(a) && !sticks(b) && !a.matches('[type=range]') && !b.matches('[type=range]')) found.push(`overlap: ${called(a)} and ${called(b)}`);
    }

  /* Inputs have names of their own, for those who do not see the label beside them. */
  for (const input of all('input, select, textarea, [role=slider], button'))
    if (inPlay(input) && input.type !== 'hidden' && !nameOf(input)) found.push(`name: ${called(input)} has none`);

  /* Text is whole, unless it ends in an ellipsis and a tip has the rest; and it stands off its ground. */
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
  const page = rgba(getComputedStyle(document.querySelector('#root')).backgroundColor);
  const lines = new Map();
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, element = node.parentElement;
    if (!words(node.data) || !inPlay(element) || element.closest('svg, style, script, .wv-bar-over')) continue;
    const style = getComputedStyle(element);
    const range = document.createRange();
    range.selectNodeContents(node);
    const text = range.getBoundingClientRect();
    if (text.width < 2 || style.clipPath !== 'none') continue;
    const grounds = [];
    let opacity = 1, drawn = false, told = false, ellipsis = false, clipped = true, cut = '';
    for (let at = element; at && at !== document.documentElement; at = at.parentElement) {
      const s = getComputedStyle(at), r = box(at);
      opacity *= Number(s.opacity);
      told ||= !!at.title;
      ellipsis ||= s.textOverflow === 'ellipsis' && s.overflowX !== 'visible';
      if (/url|gradient/.test(s.backgroundImage) && rgba(s.backgroundColor)[3] < 1 && !(grounds.at(-1)?.[3] === 1)) drawn = true;
      if (!(grounds.at(-1)?.[3] === 1)) grounds.push(rgba(s.backgroundColor));
      if (clipped && /hidden|clip/.test(s.overflowX) && r.width > 0 && (text.right > r.right + 2 || text.left < r.left - 2))
        if (!(ellipsis && told) && !at.matches('body, #root, [data-dock-root]')) cut ||= words(at.className) || at.tagName;
      clipped &&= s.position !== 'fixed';
    }
    if (cut) found.push(`cut: "${words(node.data)}" by ${cut}`);
    if (text.right > widthPx + 1) found.push(`cut: "${words(node.data)}" by the window`);
    if (drawn) continue;
    const ground = grounds.reverse().reduce((under, top) => over(top, under), page.slice(0, 3));
    const ink = rgba(style.webkitTextFillColor || style.color);
    ink[3] *= opacity;
    const [a, b] = [light(over(ink, ground)), light(ground)].sort((p, q) => q - p);
    const contrast = (a + 0.05) / (b + 0.05), size = parseFloat(style.fontSize);
    const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
    if (contrast < (large ? 3 : 4.5) - 0.005) lines.set(`${element.className}`, `pale: "${words(node.data)}" ${contrast.toFixed(2)} : 1, ${words(element.className)}`);
  }
  for (const input of all('input'))
    if (inPlay(input) && /text|number/.test(input.type) && input.scrollWidth > input.clientWidth + 1)
      found.push(`cut: what stands in ${called(input)}: ${words(input.value)}`);
  return [...new Set([...found, ...lines.values()])];
}
