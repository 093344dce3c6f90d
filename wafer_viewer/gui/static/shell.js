/* The static page gives way to the page once that has its header and a title. */
const shell = document.getElementById('wv-shell');
const giveWay = new MutationObserver(() => {
  if (!document.querySelector('.wv-hd') || !document.querySelector('.wv-title')) return;
  giveWay.disconnect();
  shell.remove();
});
if (shell) giveWay.observe(document.body, { childList: true, subtree: true });
