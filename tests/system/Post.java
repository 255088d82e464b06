import java.net.URI;
import java.net.http.HttpClient;
import java.net.http.HttpRequest;
import java.net.http.HttpRequest.BodyPublishers;
import java.net.http.HttpResponse.BodyHandlers;
import java.nio.file.Files;
import java.nio.file.Path;

/** Posts a photograph twice, with and without a known length, by Java's own client as it is. */
class Post {
    public static void main(String[] arguments) throws Exception {
        Path photograph = Path.of(arguments[1]);
        HttpClient client = HttpClient.newHttpClient();
        for (var body : new HttpRequest.BodyPublisher[] {
            BodyPublishers.ofFile(photograph),
            BodyPublishers.ofInputStream(() -> {
                try {
                    return Files.newInputStream(photograph);
                } catch (java.io.IOException error) {
                    throw new java.io.UncheckedIOException(error);
                }
            }),
        }) {
            var request = HttpRequest.newBuilder(URI.create(arguments[0]))
                .header("Content-Type", "image/jpeg").POST(body).build();
            var answer = client.send(request, BodyHandlers.ofString());
            System.out.println(answer.statusCode() + " " + answer.body());
        }
    }
}
