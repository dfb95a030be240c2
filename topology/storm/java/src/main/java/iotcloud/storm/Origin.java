package iotcloud.storm;

import java.io.Serializable;
import java.util.Collections;
import java.util.HashMap;
import java.util.Map;
import org.apache.storm.shade.net.minidev.json.JSONObject;
import org.apache.storm.shade.net.minidev.json.JSONValue;

/** Where a component's code is: in a topology's file, or in a component library; both are below resources/ in the jar. */
final class Origin implements Serializable {
  private static final long serialVersionUID = 1;
  final String file;
  final String library;
  final String className;
  final HashMap<String, String> conf;

  Origin(String file) {
    this(file, "", "", Collections.emptyMap());
  }

  /** `conf` is a JSON object of strings, numbers and booleans. */
  Origin(String library, String className, String conf) {
    this("", library, className, texts(conf));
  }

  private Origin(String file, String library, String className, Map<String, String> conf) {
    this.file = file;
    this.library = library;
    this.className = className;
    this.conf = new HashMap<>(conf);
  }

  private static Map<String, String> texts(String conf) {
    Map<String, String> texts = new HashMap<>();
    Object read = JSONValue.parse(conf);
    if (!(read instanceof JSONObject)) {
      throw new IllegalArgumentException("the component's conf is no JSON object: " + conf);
    }
    ((JSONObject) read).forEach((key, value) -> texts.put(key, String.valueOf(value)));
    return texts;
  }
}
