package mix;

import java.io.IOException;
import java.io.UncheckedIOException;
import java.nio.file.Files;
import java.nio.file.Path;
import java.nio.file.Paths;
import java.nio.file.StandardCopyOption;
import java.util.ArrayList;
import java.util.List;
import java.util.Map;
import java.util.TreeMap;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.BasicOutputCollector;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.base.BaseBasicBolt;
import org.apache.storm.tuple.Tuple;

/**
 * Writes, once all readings are done, which task counted a key, and how often that key came by whom: a line for each task
 * and key, so that a key that two tasks counted has two lines.
 */
public class Table extends BaseBasicBolt {
  private static final long serialVersionUID = 1;
  private final String file;
  private transient Map<String, Map<String, Long>> rows;

  public Table(String file) {
    this.file = file;
  }

  @Override
  public void prepare(Map<String, Object> conf, TopologyContext context) {
    rows = new TreeMap<>();
  }

  @Override
  public void execute(Tuple tuple, BasicOutputCollector collector) {
    if (tuple.getSourceStreamId().equals("finished")) {
      write("acked " + tuple.getLongByField("acked") + "\tfailed " + tuple.getLongByField("failed"));
      return;
    }
    String row = tuple.getSourceComponent() + "\t" + tuple.getStringByField("key") + "\ttask " + tuple.getLongByField("task");
    rows.computeIfAbsent(row, key -> new TreeMap<>()).put(tuple.getStringByField("by"), tuple.getLongByField("count"));
  }

  private void write(String head) {
    List<String> lines = new ArrayList<>();
    lines.add(head);
    rows.forEach((row, counts) -> {
      StringBuilder line = new StringBuilder(row);
      counts.forEach((by, count) -> line.append('\t').append(by).append(": ").append(count));
      lines.add(line.toString());
    });
    try {
      Path partial = Files.write(Paths.get(file + ".partial"), lines);
      Files.move(partial, Paths.get(file), StandardCopyOption.ATOMIC_MOVE);
    } catch (IOException error) {
      throw new UncheckedIOException(error);
    }
  }

  @Override
  public void declareOutputFields(OutputFieldsDeclarer declarer) {}
}
