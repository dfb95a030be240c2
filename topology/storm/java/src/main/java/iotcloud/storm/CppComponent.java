package iotcloud.storm;

import java.util.HashMap;
import java.util.Map;
import org.apache.storm.generated.StreamInfo;
import org.apache.storm.topology.IComponent;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.tuple.Fields;

/** What spouts and bolts of C++ have in common: where their code is, and what they declare to Storm. */
public abstract class CppComponent implements IComponent {
  private static final long serialVersionUID = 1;
  final Origin origin;
  private final HashMap<String, StreamInfo> streams;

  CppComponent(String file) {
    origin = new Origin(file);
    streams = new HashMap<>();
  }

  CppComponent(String kind, String library, String className, Map<String, ?> conf) {
    origin = new Origin(library, className, conf);
    streams = Library.read(library).streams(kind, className);
  }

  @Override
  public void declareOutputFields(OutputFieldsDeclarer declarer) {
    if (!origin.file.isEmpty()) {
      throw new IllegalStateException("`iotcloud topology pack` declares the components of " + origin.file
          + "; a Flux file or a Java program names a component's library and class");
    }
    streams.forEach((name, stream) ->
        declarer.declareStream(name, stream.is_direct(), new Fields(stream.get_output_fields())));
  }

  @Override
  public Map<String, Object> getComponentConfiguration() {
    return null;
  }
}
