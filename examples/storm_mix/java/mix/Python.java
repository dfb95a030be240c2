package mix;

import java.util.Map;
import org.apache.storm.task.ShellBolt;
import org.apache.storm.topology.IRichBolt;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.tuple.Fields;

/** A bolt in Python: a script below resources/ of the jar, and the fields that it emits. */
public class Python extends ShellBolt implements IRichBolt {
  private static final long serialVersionUID = 1;
  private final String[] fields;

  public Python(String script, String... fields) {
    super("python3", script);
    this.fields = fields;
  }

  @Override
  public void declareOutputFields(OutputFieldsDeclarer declarer) {
    declarer.declare(new Fields(fields));
  }

  @Override
  public Map<String, Object> getComponentConfiguration() {
    return null;
  }
}
