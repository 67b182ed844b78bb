// The camera's picture with its frame in the look of the session's state, and what to do about that.
import { PictureView } from "../picture/PictureView";
import { ellipseScale, framePicture, frameRatio, hasEdge, hasSaturated, lacking, link, shownHead, sliceShown, stepsBack } from "../state/pictures";
import { standing, standingClass } from "../state/standing";
import { paused } from "../state/store";

export function Screen() {
  const now = standing.value;
  const scale = ellipseScale.value;
  return (
    <div class="stage">
      <div class={`screen ${standingClass(now.word)}`}>
        <PictureView label={sliceShown.value ? `camera, slice ${sliceShown.value}` : "camera"} part="frame" picture={framePicture} ratio={frameRatio.value} stretches />
        {lacking.value && <p class="over">{lacking.value}</p>}
        {now.hint && !lacking.value && <p class="over low">{now.hint}</p>}
        {paused.value && <p class="over top">paused · frame {shownHead.value?.frame}{stepsBack.value > 0 ? ` · ${stepsBack.value} back` : ""} · space goes on, arrows step</p>}
      </div>
      <p class="key">
        <span><i class="line" /> {hasEdge.value ? "outline" : "contour"}</span>
        {hasEdge.value && <span title="Only pixels inside of it are compared with the formula."><i class="line edge" /> edge of its domain</span>}
        <span><i class="cross" /> centre{scale > 1 ? `, 1σ ellipse × ${scale}` : ", 1σ ellipse"}</span>
        <span><i class="dashed" /> window</span>
        {hasSaturated.value ? <span><i class="block saturated" /> saturated</span> : null}
        <span class="quiet">{link.value}</span>
      </p>
    </div>
  );
}
