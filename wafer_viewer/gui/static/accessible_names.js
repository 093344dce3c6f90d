/* Accessible names: viser draws a label beside its input and ties the two together for some inputs only. Every input
   in the row of a label gets the label as its name; a field that may be left empty says so in grey. Runs once a page.
   `window.wvOptional` holds their labels with these words. */
if (!window.wvNames) {
  const INPUTS = 'input:not([type=hidden]), textarea, select, [role=slider], [role=combobox], [role=switch]';
  const HIDDEN = 'div:has(>.wv-picks)+div input, div:has(>.wv-tells)+div input';
  const set = (at, name, value) => { if (at.getAttribute(name) !== value) at.setAttribute(name, value); };
  const nameAll = () => {
    for (const at of document.querySelectorAll(HIDDEN)) { set(at, 'aria-hidden', 'true'); set(at, 'tabindex', '-1'); }
    for (const at of document.querySelectorAll('input.mantine-Spotlight-search')) set(at, 'aria-label', 'Search the commands');
    for (const label of document.querySelectorAll('label[for]')) {
      const text = label.textContent.trim(), row = label.closest('.mantine-Flex-root');
      if (!text || !row) continue;
      const inputs = [...row.querySelectorAll(INPUTS)].filter(at => !at.matches('[aria-hidden=true]'));
      const typed = inputs.filter(at => at.getAttribute('role') !== 'slider');
      inputs.forEach(at => {
        const n = Math.max(0, typed.indexOf(at)), tied = n === 0 && at.id === label.htmlFor;
        if (!tied) set(at, 'aria-label', n === 0 ? text : typed.length === 2 ? `${text}, second` : `${text}, ${n + 1}`);
        if (inputs.length === 1 && window.wvOptional?.[text]) set(at, 'placeholder', window.wvOptional[text]);
      });
    }
  };
  let due = 0;
  window.wvNames = new MutationObserver(() => { due = due || setTimeout(() => { due = 0; nameAll(); }, 60); });
  window.wvNames.observe(document.body, { childList: true, subtree: true });
  nameAll();
}
