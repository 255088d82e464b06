// The webcam, as far as the browser lends it.

/** A stream of the camera; throws where there is none or it is not allowed. */
export async function openWebcam() {
  // Browsers know no webcams on pages that came without TLS.
  if (!navigator.mediaDevices) {
    throw new Error("browsers lend it only to pages over HTTPS or on localhost.");
  }
  return navigator.mediaDevices.getUserMedia(
    { video: { width: 640, height: 480, facingMode: "environment" } });
}
