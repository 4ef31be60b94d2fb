// Canvases are drawn with two pixels for one of the page at least, so that print is sharp.
{
  const own = Object.getOwnPropertyDescriptor(window, "devicePixelRatio"), ratio = () => own.get ? own.get.call(window) : own.value;
  Object.defineProperty(window, "devicePixelRatio", { get: () => Math.max(2, ratio()), configurable: true });
}
