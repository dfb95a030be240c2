package iotcloud.storm;

import java.io.IOException;
import java.io.InputStream;
import java.io.UncheckedIOException;
import java.nio.charset.StandardCharsets;
import java.util.Collection;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import java.util.TreeSet;
import org.apache.storm.generated.StreamInfo;
import org.apache.storm.shade.net.minidev.json.JSONObject;
import org.apache.storm.shade.net.minidev.json.JSONValue;

/**
 * What a component library registers, as `iotcloud topology pack` wrote it into the jar (topology/storm/job/classes.h): the
 * program that submits a topology loads no C++.
 */
final class Library {
  private final String name;
  private final JSONObject classes;

  private Library(String name, JSONObject classes) {
    this.name = name;
    this.classes = classes;
  }

  /** Throws IllegalArgumentException when the jar has no such library. */
  static Library read(String name) {
    try (InputStream file = Library.class.getClassLoader().getResourceAsStream("iotcloud-library/" + name + ".json")) {
      if (file == null) {
        throw new IllegalArgumentException("the jar has no component library " + name + "; `iotcloud topology pack " + name
            + " OUT.jar --onto THIS.jar` makes one that has it");
      }
      return new Library(name, (JSONObject) JSONValue.parse(new String(file.readAllBytes(), StandardCharsets.UTF_8)));
    } catch (IOException error) {
      throw new UncheckedIOException(error);
    }
  }

  /** The streams that a class declares. `kind` is spout or bolt. Throws IllegalArgumentException for an unknown class. */
  HashMap<String, StreamInfo> streams(String kind, String className) {
    HashMap<String, StreamInfo> streams = new HashMap<>();
    for (Map.Entry<String, Object> stream : object(find(kind, className)).entrySet()) {
      JSONObject described = object(stream.getValue());
      @SuppressWarnings("unchecked")
      List<String> fields = (List<String>) described.get("fields");
      streams.put(stream.getKey(), new StreamInfo(fields, (Boolean) described.get("direct")));
    }
    return streams;
  }

  /** Throws IllegalArgumentException for an unknown class. */
  void requireGrouping(String className) {
    find("grouping", className);
  }

  private Object find(String kind, String className) {
    JSONObject known = object(classes.get(kind));
    if (!known.containsKey(className)) {
      Collection<String> names = new TreeSet<>(known.keySet());
      throw new IllegalArgumentException(name + " has no " + kind + " " + className + "; "
          + (names.isEmpty() ? "it has none" : "it has " + String.join(", ", names)));
    }
    return known.get(className);
  }

  private static JSONObject object(Object json) {
    return (JSONObject) json;
  }
}
