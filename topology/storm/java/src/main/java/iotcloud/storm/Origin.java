package iotcloud.storm;

import java.io.Serializable;
import java.util.Collections;
import java.util.HashMap;
import java.util.Map;

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

  /** `conf` has texts, numbers and booleans. */
  Origin(String library, String className, Map<String, ?> conf) {
    this("", library, className, texts(conf));
  }

  private Origin(String file, String library, String className, Map<String, String> conf) {
    this.file = file;
    this.library = library;
    this.className = className;
    this.conf = new HashMap<>(conf);
  }

  private static Map<String, String> texts(Map<String, ?> conf) {
    Map<String, String> texts = new HashMap<>();
    conf.forEach((key, value) -> {
      if (!(value instanceof String || value instanceof Number || value instanceof Boolean)) {
        throw new IllegalArgumentException("conf of a C++ component: \"" + key + "\" is " + value
            + "; write a text, a number or a boolean");
      }
      texts.put(key, value.toString());
    });
    return texts;
  }
}
