package interop;

import java.io.BufferedReader;
import java.io.InputStreamReader;
import java.nio.charset.StandardCharsets;

/**
 * Plays programs of the original system. Takes a line of words for each play on standard input and answers each with one
 * line, so that one JVM serves a whole test:
 *
 * <pre>
 * topology ZOOKEEPER KIND SERVER DRIVER COUNT            reads `data` of a driver of ours and answers on `control`
 * gateway ZOOKEEPER KIND SERVER DRIVER COUNT INSTANCES GROUPED  is a gateway with drivers, which a topology of ours answers
 * </pre>
 *
 * KIND: rabbitmq or kafka. The answer: "sent N received N twice N wrong N others NAME=N,...", or "error: " and what went
 * wrong. `others`: how many messages brought a header that is neither the original's nor a property of the play; "none".
 */
public final class Main {
    private Main() {}

    public static void main(String[] args) throws Exception {
        var lines = new BufferedReader(new InputStreamReader(System.in, StandardCharsets.UTF_8));
        for (String line = lines.readLine(); line != null; line = lines.readLine()) {
            String answer;
            try {
                answer = play(line.split(" "));
            } catch (Exception error) {
                error.printStackTrace();
                answer = "error: " + error;
            }
            System.out.println(answer);
        }
    }

    private static String play(String[] words) throws Exception {
        try (var records = new Records(words[1]); var wire = Wire.of(words[2], words[3])) {
            String driver = words[4];
            int count = Integer.parseInt(words[5]);
            return switch (words[0]) {
                case "topology" -> new Topology(records, wire).answer(driver, count);
                case "gateway" -> new Gateway(records, wire, words[2], words[3])
                        .run(driver, count, Integer.parseInt(words[6]), Boolean.parseBoolean(words[7]));
                default -> throw new IllegalArgumentException("no such play: " + words[0]);
            };
        }
    }
}
