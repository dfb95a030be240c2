package mix;

import java.util.HashMap;
import java.util.List;
import java.util.Map;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.BasicOutputCollector;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.base.BaseBasicBolt;
import org.apache.storm.tuple.Fields;
import org.apache.storm.tuple.Tuple;
import org.apache.storm.tuple.Values;

/** Counts how often each level came by whom. */
public class CountLevels extends BaseBasicBolt {
  private static final long serialVersionUID = 1;
  private transient Map<List<String>, Long> counts;
  private transient long task;

  @Override
  public void prepare(Map<String, Object> conf, TopologyContext context) {
    counts = new HashMap<>();
    task = context.getThisTaskId();
  }

  @Override
  public void execute(Tuple tuple, BasicOutputCollector collector) {
    String level = String.valueOf(tuple.getValueByField("level"));
    String by = tuple.getStringByField("by");
    collector.emit(new Values(level, by, counts.merge(List.of(level, by), 1L, Long::sum), task));
  }

  @Override
  public void declareOutputFields(OutputFieldsDeclarer declarer) {
    declarer.declare(new Fields("key", "by", "count", "task"));
  }
}
