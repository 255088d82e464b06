// java Main URL PHOTOGRAPH: a photograph, then four frames of a camera, half a second apart.
import java.io.File;
import java.util.ArrayList;
import org.openapitools.client.ApiClient;
import org.openapitools.client.api.CamerasApi;
import org.openapitools.client.api.PoseApi;

public class Main {
  public static void main(String[] arguments) throws Exception {
    ApiClient client = new ApiClient();
    client.setBasePath(arguments[0]);
    File photograph = new File(arguments[1]);
    int width =
        new PoseApi(client)
            .estimatePose(
                null, null, null, null, null, null, null, null, null, null, null, null, photograph,
                null, null, null)
            .getImage()
            .getWidth();
    ArrayList<Double> times = new ArrayList<>();
    for (int frame = 0; frame < 4; frame++) {
      double at = 1795880000.25 + 0.5 * frame;
      boolean inQuery = frame % 2 == 0;
      times.add(
          new CamerasApi(client)
              .trackFrame(
                  "java", null, null, null, null, null, null, null, null, null, null, null,
                  inQuery ? at : null, null, photograph, null, null, null, null, inQuery ? null : at)
              .getTimestamp());
    }
    System.out.println("{\"width\": " + width + ", \"times\": " + times + "}");
  }
}
