package interop;

import java.nio.charset.StandardCharsets;
import java.util.Map;

/** A message as the original's programs have it: a body, and headers whose values are texts. */
record Message(byte[] body, Map<String, String> headers) {
    static final String SENSOR = "sensorID";
    static final String SITE = "siteID";
    static final String TIME = "time";

    String text() {
        return new String(body, StandardCharsets.UTF_8);
    }

    static Message of(String text, Map<String, String> headers) {
        return new Message(text.getBytes(StandardCharsets.UTF_8), headers);
    }

    boolean says(Map<String, String> expected) {
        return expected.entrySet().stream().allMatch(entry -> entry.getValue().equals(headers.get(entry.getKey())));
    }
}
