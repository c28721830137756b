for (const slider of document.querySelectorAll(".slider input"))
  slider.addEventListener("input", () => slider.closest(".slider").style.setProperty("--at", slider.value + "%"));
