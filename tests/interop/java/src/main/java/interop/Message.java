package interop;

import java.nio.charset.StandardCharsets;
import java.util.List;
import java.util.Map;
import java.util.Set;
import java.util.TreeSet;

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

    /** The names of headers that are neither the original's nor the given ones. */
    Set<String> othersThan(String... known) {
        Set<String> others = new TreeSet<>(headers.keySet());
        others.removeAll(List.of(SENSOR, SITE, TIME));
        others.removeAll(List.of(known));
        return others;
    }

    boolean says(Map<String, String> expected) {
        return expected.entrySet().stream().allMatch(entry -> entry.getValue().equals(headers.get(entry.getKey())));
    }
}
