package iotcloud.storm;

import java.io.IOException;
import java.io.InputStream;
import java.nio.charset.StandardCharsets;
import java.util.Map;
import org.apache.storm.StormSubmitter;
import org.apache.storm.generated.StormTopology;
import org.apache.storm.shade.net.minidev.json.JSONObject;
import org.apache.storm.shade.net.minidev.json.JSONValue;
import org.apache.storm.utils.Utils;

/** What `storm jar` runs: submits the topology that stands in the jar, with Storm's own client. */
public final class Submit {
  private Submit() {}

  public static void main(String[] words) throws Exception {
    JSONObject job = (JSONObject) JSONValue.parse(new String(read("iotcloud-job.json"), StandardCharsets.UTF_8));
    @SuppressWarnings("unchecked")
    Map<String, Object> conf = (Map<String, Object>) job.get("conf");
    StormTopology topology = Utils.thriftDeserialize(StormTopology.class, read("iotcloud-topology.bin"));
    StormSubmitter.submitTopology((String) job.get("name"), conf, topology);
  }

  private static byte[] read(String name) throws IOException {
    try (InputStream file = Submit.class.getClassLoader().getResourceAsStream(name)) {
      if (file == null) {
        throw new IOException(name + " is not in the jar; iotcloud-storm pack makes one that has it");
      }
      return file.readAllBytes();
    }
  }
}
