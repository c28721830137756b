for (const button of document.querySelectorAll("button.copy")) {
  button.hidden = false;
  button.addEventListener("click", async () => {
    const from = button.parentElement.querySelector("pre");
    try { await navigator.clipboard.writeText(from.textContent); }
    catch { getSelection().selectAllChildren(from); document.execCommand("copy"); }
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
}
